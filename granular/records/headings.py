"""Names, roles and units of columns, in the spellings of people and programs."""

from __future__ import annotations

import re
import shlex
from typing import Any, Literal

from granular.schema.units import Dimension, unit_size
from granular.shared.errors import RecordError, SceneError, quote, sanitize

TIME, HEIGHT, VELOCITY, FORCE = "time", "height", "velocity", "force"
ACCELERATION = "acceleration"
BASE_HEIGHT, BASE_ACCELERATION = "base_height", "base_acceleration"
INPUT = "input"
"""Role of inputs such as a voltage or a temperature; a column with this role is never taken as the height."""


def _split_names(text: str) -> tuple[str, ...]:
    return tuple(" ".join(name.split()) for name in text.split(","))


SYNONYMS = {
    TIME: _split_names(
        """time, t, times, elapsed time, elapsed, relative time, time stamp, timestamp, datetime, date time,
        x value, zeit, temps, tiempo, tempo, tijd, messzeit, zeitstempel, uhrzeit, durée, duree, instant,
        horodatage, tiempo transcurrido"""
    ),
    HEIGHT: _split_names(
        """height, z, h, piston height, piston position, höhe, hoehe, hauteur, altura, position, pos,
        displacement, disp, deflection, stroke, travel, weg, auslenkung, level, distance, dist, y, x, angle,
        theta, θ, phi, φ, winkel, rotation, encoder, laser, lvdt, amplitude, heave, roll, pitch, deplacement,
        déplacement, desplazamiento, posición, posicion, verplaatsing, spostamento, deslocamento, elongation,
        elongación, ort, élongation, hub, durchbiegung, federweg, verschiebung, abstand, lage, drehwinkel,
        neigung, longueur, course, flèche, écart, ángulo, angulo, distancia, recorrido, elongacion,
        axial displacement, ax displ, extension, damper displacement, piston displacement, β, alpha, α"""
    ),
    VELOCITY: _split_names(
        """velocity, v, vel, speed, piston velocity, geschwindigkeit, vitesse, velocidad, omega,
        angular velocity, gyro, gyroscope, winkelgeschwindigkeit, velocidad angular, vitesse angulaire, ω,
        damper velocity, axial velocity"""
    ),
    FORCE: _split_names(
        "force, f, piston force, kraft, load cell, fuerza, effort, axial force, ax force, damper force"
    ),
    ACCELERATION: _split_names(
        """acceleration, accel, acc, a, az, ay, ax, beschleunigung, accelerometer, aceleracion, aceleración,
        accélération"""
    ),
    INPUT: _split_names(
        """input, control, control voltage, voltage, current, spannung, strom, u, i, tension, corriente,
        drive, command, setpoint, temperature, temperatur, voltaje, tensión, courant, intensidad,
        température, temperatura, steuerspannung, stellgröße, sollwert, consigne, consigna, pressure, druck,
        pression, presión"""
    ),
}
"""Names of columns for each role, in lower case and without punctuation, in order of precedence."""

ANGLES = _split_names(
    "angle,theta,θ,phi,φ,winkel,rotation,angulo,ángulo,roll,pitch,drehwinkel,neigung,alpha,α,β"
)
"""Names of columns that hold an angle."""
PREFERRED = SYNONYMS[HEIGHT][:9]
"""Names of the height that take precedence over its other names."""
LOADS = _split_names("load, last, charge, carga, axial load")
"""Names of columns that hold a force if their unit is a unit of force."""
COUNTERS = _split_names(
    "frame,frames,sample,samples,index,n,no,nr,number,step,bild,image,muestra,échantillon"
)
"""Names of columns that count samples."""

_DERIVED_QUANTITY = re.compile(
    r"[avr][xyz]?|θr|r θ|θ[avp]|[xyz]|p[xyz]?|pixel ?[xy]|k|ke|pe|e[ckmpt]"
    r"|.*\b(energ\w+|énergie|momentum|impuls)\b.*"
)
"""Names of quantities derived from the motion: other coordinates, energies, momenta."""
NOT_TIME_WORDS = frozenset(
    _split_names(
        """frequency, freq, frequenz, fréquence, frecuencia, wavelength, wavenumber, wellenlänge, lambda,
        energy, length, strain, distance, amplitude, temperature, 2theta, order"""
    )
)
"""Words in names of columns that are not times, although they increase in even steps."""

_SPELLINGS = {
    "s": "sec secs second seconds sek sekunde sekunden segundo segundos seconde secondes",
    "ms": "msec msecs millisecond milliseconds millis millisekunden milisegundos millisecondes",
    "us": "μs µs usec microsecond microseconds micros",
    "d": "day days tage jours días",
    "min": "minute minutes",
    "h": "hour hours hr hrs",
    "m": "meter meters metre metres metro metros mètre mètres",
    "mm": "millimeter millimeters millimetre millimetres milímetros milimetros millimètres",
    "cm": "centimeter centimeters centimetre centimetres zentimeter centímetros centimètres",
    "um": "μm µm micron microns micrometer micrometers micrometre micrometres",
    "mil": "mils",
    "in": "inch inches",
    "ft": "feet foot",
    "counts": "count cnt cts ticks",
    "px": "pixel pixels píxel píxeles pixeles",
    "V": "volt volts voltios",
    "mV": "millivolt",
    "N": "newton newtons",
    "kN": "kilonewton",
    "deg": "° ^circ º degree degrees grad grado grados degré degrés",
    "deg/s": "°/s",
    "rad": "radian radians bogenmaß radianes",
    "m/s": "m/sec",
    "mm/s": "mm/sec",
    "m/s^2": "m/s2 m/s² m/s/s",
}
"""Alternative spellings of the units in `granular.schema.units`."""
_UNITS = {spelling: unit for unit, spellings in _SPELLINGS.items() for spelling in spellings.split()}

_KNOWN = {
    *_SPELLINGS,
    *_split_names(
        "ns,nm,km,mN,lbf,kgf,mrad,cm/s,in/s,ft/s,rad/s,mm/s^2,g,A,K,°C,C,Hz,Pa,kPa,bar,1,%,mA,lb,kip,psi"
    ),
}
"""Units that are recognized after a name, without brackets."""

_CAPITALS = ("S", "MS", "US", "M", "MM", "CM", "UM", "IN", "FT", "DEG", "RAD")
"""Units of time, length and angle, in headings that are all capitals."""
_UNITS_WITHOUT_NAME = ("V", "mV", "mA", "counts", "px", "mm", "cm", "um", "mil", "deg", "rad", "mrad")
"""Units of quantities other than time that may form a heading without a name."""
_LONGEST = 100
"""Maximum length of a header in which a unit without brackets is looked for."""
_SHORT_TIME_UNITS = ("s", "ms", "us")
_LONG_TIME_UNITS = ("min", "h", "d")
"""Units of time whose symbols may also mean minimum or height; only their full names are unambiguous."""
_SHORTEST_WORD = 4
_AXIS = re.compile(r" ([xyz]|abs.*|total)$")
"""Axis of a vector after the name of the quantity."""
_BRACKETS = re.compile(r"[\[\({]([^\[\](){}]*)[\]\)}]")
"""A unit or a remark in brackets."""
_RUN_LABEL = re.compile(
    r"^(latest|run \d+|letzter durchgang|última) | (run|durchgang|essai|ensayo|serie)( nr)? \d+$"
)
"""Words that school data loggers put before or after a name."""
CHANNEL = re.compile(r"(ch|chan|channel|kanal|canal|voie|ai|ain|adc|analog|sensor) ?\d+")
"""Normalized names of the input channels of an instrument, which do not reveal the measured quantity."""
_CASSY_INPUT = re.compile(r"(\w) ?[ab][12]|([ui]) ?\d")
"""Names in CASSY Lab: a quantity and its input, as in sA1, or a voltage or current, as in U1."""
_TEX = re.compile(r"\\(?:mathrm|text|rm|si|unit)\b|\\[,;: !]|_\{[^}]*\}|_\w|[\${}\\]")
_NAME_IN_UNIT = re.compile(r"(.*)\b(?:in|en)\s+([^\s_,:]+)")
_NAME_OVER_UNIT = re.compile(r"(\S[^/]{0,40}?)\s+/\s+(\S+)")
"""A quantity over its unit, with spaces around the slash."""
_NAME_THEN_UNIT = re.compile(r"(.+?)\s*(?:/|_|,|:|\s)\s*([^\s_,:]+)")
_NAME_UNIT_SUFFIX = re.compile(r"(.*\w)_(mm|cm|um|nm|ms|us|deg|m?rad|m[VA]|px|counts|k?Pa|kN|Hz|psi)")
"""Suffixes that are read as a unit after any name; ``_in``, ``_min`` and single letters would be ambiguous.
"""
_POWER_OF_TEN = re.compile(
    r"[x×*·]?\s*10\s*(?:\^|\*\*)?\s*\(?([+-]?\d)\)?\s*[x×*·]?\s*((?:[^\W\d]|°).*)|1[eE]([+-]?\d{1,2})\s*(\D.*)"
)
"""A unit after a power of ten, as in ``x10^-3 m`` or ``1e-3 m``."""
_PREFIXES = {-9: "n", -6: "u", -3: "m", -2: "c", 3: "k"}
_SUPERSCRIPTS = str.maketrans("⁻⁺⁰¹²³⁴⁵⁶⁷⁸⁹−", "-+0123456789-")

# Names and units in a heading --------------------------------------------------------------------


def normalize_unit(unit: str) -> str:
    """Spell a known unit as in `granular.schema.units`; return any other unit unchanged."""
    bare = unit.strip().strip("[](){}").strip().rstrip(".").replace("²", "^2")
    power = _POWER_OF_TEN.fullmatch(bare.translate(_SUPERSCRIPTS)) if len(bare) <= _LONGEST else None
    if power is not None:
        exponent, base = int(power[1] or power[3]), normalize_unit(power[2] or power[4])
        prefixed = f"{_PREFIXES.get(exponent)}{base}"
        return prefixed if prefixed in _KNOWN else f"10^{exponent} {base}"
    bare = bare.lower() if bare in _CAPITALS else bare
    return _UNITS.get(bare, _UNITS.get(bare.lower(), bare))


def is_unit(text: str) -> bool:
    """Return True for a cell that holds only a known unit, with or without brackets."""
    normal = normalize_unit(text)
    # a single d is more likely a name, as in x_d, than a day
    return (normal in _KNOWN and text.strip() != "d") or (
        normal.startswith("10^") and normal.split(" ", 1)[1] in _KNOWN
    )


_SPLITS: tuple[tuple[re.Pattern[str], float, Any], ...] = (
    (_NAME_IN_UNIT, float("inf"), lambda name, unit: is_unit(unit)),
    (_NAME_OVER_UNIT, _LONGEST, lambda name, unit: is_unit(unit)),
    (_NAME_THEN_UNIT, _LONGEST, lambda name, unit: is_unit(unit) and guess_column_role(name) is not None),
    (_NAME_UNIT_SUFFIX, _LONGEST, lambda name, unit: True),
)
"""Patterns of headings with a unit without brackets, each with a maximum length and a further condition.

The patterns match, in this order:

- ``height in mm``;
- the quotient ``s / mm`` of ISO 80000 with any name and a known unit;
- ``height/mm``, ``height_mm``, ``height mm`` and ``height, mm``, if name and unit are known;
- ``x_mm`` with any name.
"""


def split_header_into_name_and_unit(cell: str) -> tuple[str, str | None]:
    """Split a column's header into its name and its unit."""
    cell = cell.strip()
    if ("$" in cell or "_{" in cell) and len(
        cell
    ) <= _LONGEST:  # Tracker writes t_{1} without TeX's dollar signs
        cell = _TEX.sub("", cell).strip()
    group = _find_unit_brackets(cell)
    if group is not None:
        rest = f"{cell[: group.start()].strip()} {cell[group.end() :].strip()}".strip()
        unit = group[1].strip() or None
        if unit is None or is_unit(unit) or group[0][0] == "[" or len(cell) > _LONGEST:
            return rest, unit
        name, before = split_header_into_name_and_unit(
            rest
        )  # the brackets hold a remark, perhaps after a unit without brackets
        if before is not None:
            return f"{name} {group[0]}", before
        if " " in unit or unit == "t" or unit.isdigit():
            return cell, None
        # an unusual unit such as mN, an unknown unit, or part of the name
        return (rest if not rest or dimension_of(unit) else cell), unit
    for form, longest, fits in _SPLITS:
        match = form.fullmatch(cell) if len(cell) <= longest else None
        if match is not None and fits(match[1], match[2]):
            name = match[1].strip()
            return name or (TIME if normalize_unit(match[2]) in _SHORT_TIME_UNITS else ""), match[2]
    normal = normalize_unit(cell)
    if (normal in _SHORT_TIME_UNITS and len(cell) > 1) or (
        normal in _LONG_TIME_UNITS and len(cell) >= _SHORTEST_WORD
    ):
        return TIME, cell
    return cell, cell if normal in _UNITS_WITHOUT_NAME and len(cell) > 1 else None


def name_and_unit(header: str, label: str | None, notes: list[str]) -> tuple[str, str | None]:
    """Return the name and unit of a column; a separate label of the unit takes precedence over the header."""
    name, unit = split_header_into_name_and_unit(header)
    label = (label or "").strip("[](){} ")
    known = unit is not None and is_unit(unit)
    if not label or (known and not is_unit(label)):
        return name, unit
    if known and normalize_unit(str(unit)) != normalize_unit(label):
        word = shlex.quote(f"{name}={sanitize(unit)}")
        notes.append(
            f"{quote(header)} is in {sanitize(label)} according to its label (for {sanitize(unit)}: --units "
            f"{word})"
        )
    return name, label


def _find_unit_brackets(cell: str) -> re.Match[str] | None:
    """Find the brackets with the unit: those with a known unit, else square brackets, else the first ones."""
    groups = list(_BRACKETS.finditer(cell))
    units = [group for group in groups if is_unit(group[1])]
    dimensional = [group for group in units if group[1].strip() != "1"]
    square = [group for group in groups if group[0].startswith("[")]
    return [None, *groups[:1], *square, *units, *dimensional][-1]


def guess_role_without_axis(name: str) -> str | None:
    """Guess the role of a column from its name after removing an axis, such as the x of ``Gyroscope x``."""
    return guess_column_role(_AXIS.sub("", normalize_column_name(name)))


def normalize_column_name(name: str) -> str:
    """Reduce a column's name to lower-case words, and omit run numbers and remarks in brackets."""
    words = re.sub(r"[\W_]+", " ", _BRACKETS.sub(" ", name.lower())).split()
    phrase = _RUN_LABEL.sub("", " ".join(words))
    match = _CASSY_INPUT.fullmatch(phrase)
    return (match[1] or match[2]) if match else phrase


def is_derived_from_motion(name: str) -> bool:
    """Return True if a name means time, motion, a quantity derived from motion, or a count of samples."""
    words = normalize_column_name(name)
    return (
        guess_column_role(name) in (TIME, HEIGHT, VELOCITY, ACCELERATION)
        or words in COUNTERS
        or _DERIVED_QUANTITY.fullmatch(words) is not None
        or guess_role_without_axis(name) in (VELOCITY, ACCELERATION)
    )


def guess_column_role(name: str) -> str | None:
    """Guess the role of a column from its name, using `SYNONYMS`."""
    words = normalize_column_name(name)
    return next((role for role, known in SYNONYMS.items() if words in known), None)


# Units of roles ----------------------------------------------------------------------------------

SI = {
    TIME: "s",
    HEIGHT: "m",
    VELOCITY: "m/s",
    FORCE: "N",
    ACCELERATION: "m/s^2",
    BASE_HEIGHT: "m",
    BASE_ACCELERATION: "m/s^2",
}
"""SI unit of each role if the coordinate is a height."""
CoordinateUnit = Literal["m", "rad"]
COORDINATES: dict[CoordinateUnit, str] = {"m": "height", "rad": "angle"}
"""Name of the coordinate by its SI unit."""
ANGLE_UNITS = ("deg", "rad", "mrad")
_DECIBEL = re.compile(r"dB(\W.*|[a-zA-Zµ]{0,3})")
_UNITS_BY_ROLE = {
    **{(role, "g"): (9.80665, "m/s^2") for role in (ACCELERATION, BASE_ACCELERATION)},
    **{(role, "mg"): (9.80665e-3, "m/s^2") for role in (ACCELERATION, BASE_ACCELERATION)},
    (FORCE, "lb"): (4.4482216152605, "N"),
    (FORCE, "kg"): (9.80665, "N"),
    (FORCE, "g"): (9.80665e-3, "N"),
}
"""Units with a special meaning in a role: multiples of gravity, and masses used as forces."""


def example_unit(role: str) -> str:
    """Return an example of a unit for a role, for error messages."""
    return "mm" if role in (HEIGHT, BASE_HEIGHT) else SI.get(role, "V")


def is_logarithmic_unit(unit: str) -> bool:
    """Return True for a logarithmic unit such as dB or dBm."""
    return _DECIBEL.fullmatch(unit) is not None


def si_unit_of_role(role: str, coordinate_unit: CoordinateUnit = "m") -> str:
    """Return the SI unit to which the column of a role is converted."""
    return SI.get(role, "").replace("m", coordinate_unit)


def role_unit_size_and_dimension(role: str, unit: str) -> tuple[float, Dimension]:
    """Return the size in SI and the dimension of a unit of the column of a role."""
    if (role, unit) not in _UNITS_BY_ROLE:
        return unit_size(unit)
    size, plain = _UNITS_BY_ROLE[role, unit]
    return size, unit_size(plain)[1]


def dimension_of(unit: str | None, role: str = "") -> Dimension | None:
    """Return the physical dimension of a unit in any spelling, or None if the unit is missing or unknown."""
    try:
        return None if unit is None else role_unit_size_and_dimension(role, normalize_unit(unit))[1]
    except SceneError:
        return None


def has_dimension_of_any(unit: str | None, *units: str) -> bool:
    """Return True for a unit with the dimension of one of the other units."""
    return dimension_of(unit) in [unit_size(other)[1] for other in units]


def unit_size_of_quantity(role: str, text: str) -> float:
    """Return the size in SI of a unit of pint or astropy; raise an error if it does not fit the role."""
    try:
        size, dimension = role_unit_size_and_dimension(role, normalize_unit(text))
    except SceneError as error:
        raise RecordError(f"{sanitize(role)}: {error}; convert the quantity to an SI unit") from None
    if role in SI and dimension not in [unit_size(si_unit_of_role(role, unit))[1] for unit in COORDINATES]:
        raise RecordError(
            f"{role}: the unit {quote(text)} does not fit; a unit like {SI[role]} is needed: convert the "
            "quantity to it"
        )
    return size
