"""Fits of random records: each gives finite parameters, or a one-line error with the reason."""

import itertools
import tempfile
import time
import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from records import record_of
from trials import LONGEST, Outcome, random_of, refused, tell, wanted

from granular.shared.errors import InputError
from reduced_models import fit
from reduced_models.records.first_guesses import first_guesses

LAWS = ("linear", "z'' + 2*c*z' + k*(z - r) = 0")
"""A law of the package, and one of its text alone."""


def main() -> None:
    options = wanted(__doc__).parse_args()
    with tempfile.TemporaryDirectory() as folder:

        def readable(number: int) -> bool:
            try:
                record = record_of(random_of(options.seed, number), Path(folder))
                first_guesses(record.time, record.height)
            except InputError:
                return False
            return True

        def numbers() -> Iterator[int]:
            found = filter(readable, itertools.count(options.first))
            return itertools.islice(found, options.count)

        def trial(number: int) -> Outcome:
            record = record_of(random_of(options.seed, number), Path(folder), options.show)
            started = time.process_time()
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")
                    model = fit(record, LAWS[number % 2], starts=4)
            except InputError as error:
                return refused(error)
            assert np.isfinite(list(model.parameters.values())).all()
            assert np.isfinite(model.quality.residual)
            assert "nan" not in str(model)
            # The first of a kind compiles.
            assert time.process_time() - started < 2.0 * LONGEST
            return "fitted", ""

        tell(trial, numbers())


if __name__ == "__main__":
    main()
