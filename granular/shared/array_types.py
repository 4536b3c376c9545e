"""Types of arrays with shapes; only type checkers import them from jaxtyping, whose import takes time."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from jaxtyping import Bool, Complex, Float, Int, Shaped
else:
    Bool = Complex = Float = Int = Shaped = Any

__all__ = ["Bool", "Complex", "Float", "Int", "Shaped"]
