"""Random texts of laws of motion: each is read and can be evaluated, or is refused in one line."""

import sys
import warnings

import numpy as np
from trials import Outcome, Random, a_minute, random_of, refused, tell, wanted

from granular.formulas import FUNCTIONS
from granular.shared.errors import InputError
from reduced_models.laws.equation import compile_jacobian, compile_rates
from reduced_models.laws.law import law_from_text

NAMES = ("z", "z'", "z''", "k", "c", "omega", "λ", "lambda", "w", "rest", "x0", "numpy", "pi", "e")
NUMBERS = ("0", "1", "2", "3", "0.5", "1e-3", "7.25", "1e99", "1e-120", "64", "100", "1/3", "00.10")
SIGNS = ("+", "-", "*", "/", "**", "^")
STRANGE = (
    "'", '"', ".", "[", "]", "{", "}", ":", ":=", "=", ";", "#", "\\", "@", "!", "$", "%", "&", "|",
    "~", "<", ">", "?", "`", "\x00", "\x1b", "\n", "\t", "²", "−", "\u0430", "\uff41", "\u202e",
    "__", "lambda:", "for x in z", "if z else", "import os", "await", "()", "(,)", "1_0", "0x1",
    "1j", "z.real", "f'{z}'", "b'z'", "*z", "**z", "...", "None", "eval(z)", "\ud800", "\U0001d467",
    ",",
)  # fmt: skip


def formula(random: Random, depth: int) -> str:
    """Return a random formula, valid in most cases."""
    if depth <= 0 or random.uniform() < 0.2:
        return str(random.choice(NAMES if random.uniform() < 0.7 else NUMBERS))
    match int(random.integers(8)):
        case 0:
            name = str(random.choice(list(FUNCTIONS)))
            count = int(random.integers(1, 4)) if name in ("max", "min") else 1
            return f"{name}({', '.join(formula(random, depth - 1) for _ in range(count))})"
        case 1:
            return f"({formula(random, depth - 1)})"
        case 2:
            return f"-{formula(random, depth - 1)}"
        case 3:
            power = random.choice(["2", "3", "0.5", "-1", "k", "9"])
            return f"({formula(random, depth - 1)})**{power}"
        case 4:
            return " + ".join(formula(random, depth - 2) for _ in range(int(random.integers(2, 12))))
        case _:
            left, right = formula(random, depth - 1), formula(random, depth - 1)
            return f"{left}{random.choice(SIGNS)}{right}"


def made_text(random: Random) -> str:
    """Return the text of a random law of motion, often with an error."""
    parts = [f"z'' + {formula(random, int(random.integers(1, 7)))}"]
    if random.uniform() < 0.3:
        parts[0] = formula(random, 4)
    parts.append(formula(random, 2) if random.uniform() < 0.5 else "0")
    text = " = ".join(parts)
    if random.uniform() < 0.2:
        text += f"; w' = {formula(random, 3)}"
    for _ in range(int(random.choice([0, 0, 0, 1, 2]))):
        place = int(random.integers(len(text) + 1))
        match int(random.integers(5)):
            case 0:
                text = f"{text[:place]}{random.choice(STRANGE)}{text[place:]}"
            case 1:
                text = text[:place] + text[place + int(random.integers(1, 4)) :]
            case 2:
                text = text[:place] + text[place:][::-1]
            case 3:
                text = f"{text[:place]}{text[place : place + 9] * int(random.integers(2, 60))}"
            case 4:
                text = f"{text[:place]}{chr(int(random.integers(1, 0x3000)))}{text[place:]}"
    return text


def outcome(text: str) -> Outcome:
    """Read a text and return the outcome; assert that a valid law can be evaluated and differentiated."""
    try:
        law = law_from_text(text)
    except InputError as error:
        return refused(error)
    state = np.full(2 + len(law.hidden) + len(law.parameters), 0.7)
    with np.errstate(all="ignore"):
        found = compile_rates(text, (), "numpy")(*state)
        compile_jacobian(text)(*state.tolist())
    assert len(found) == 1 + len(law.hidden)
    assert all(np.isrealobj(np.asarray(each, dtype=float)) for each in found)
    return "read", ""


def main() -> None:
    options = wanted(__doc__).parse_args()

    def trial(number: int) -> Outcome:
        text = made_text(random_of(options.seed, number))
        if options.show:
            print(repr(text), file=sys.stderr)
        with a_minute(), warnings.catch_warnings():
            warnings.simplefilter("error")
            return outcome(text)

    tell(trial, range(options.first, options.first + options.count))


if __name__ == "__main__":
    main()
