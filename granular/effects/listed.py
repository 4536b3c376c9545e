"""Effects that a scene gives as a list of tables, or as one table."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Self

from granular.effects.effect import Effect
from granular.schema.sections import FieldError

if TYPE_CHECKING:
    from granular.schema.parts import Cell, Grains, Piston


class Listed(Effect):
    """Base of such an effect: its subclass declares ``fields``, whose sections are effects."""

    if TYPE_CHECKING:
        fields: tuple[Any, ...]

    @classmethod
    def from_plain(cls, plain: Any, diameter: float | None = None) -> Self:
        tables = [plain] if isinstance(plain, Mapping) else plain
        try:
            return super().from_plain({"fields": tables}, diameter)
        except FieldError as error:
            raise FieldError(error.reason, *error.path[1:]) from None

    def to_plain(self) -> Any:
        return [one.to_plain() for one in self.parts]

    @property
    def parts(self) -> tuple[Effect, ...]:
        return self.fields

    def check(
        self, grains: Grains, cell: Cell, piston: Piston | None, others: Mapping[str, Effect]
    ) -> None:
        for one in self.parts:
            one.check(grains, cell, piston, others)
