"""Whether a term can be weighed along a motion: finite, without a pole, and with finite slopes."""

from __future__ import annotations

import numpy as np

from reduced_models.discovery.terms import AnyTerm
from reduced_models.discovery.weak_form import SmoothedMotion

_POLE = 1e3  # growth between samples from which on a term has a pole there
_PEAKS = 100  # the greatest ones are looked into
_ZOOMS = 12
_GRID = np.linspace(-1.0, 1.0, 33)


def fault(motion: SmoothedMotion, term: AnyTerm) -> str:
    """What is wrong with a term along a motion, in words; empty where nothing is."""
    drive = motion.drive
    for z in (motion.z, motion.smooth):
        if not np.isfinite(term.values(z, motion.velocity, drive)).all():
            return "is not finite"
        if has_pole(term, z, motion.velocity, drive):
            return "has a pole"
    if not all(np.isfinite(slope).all() for slope in _slopes(motion, term)):
        return "has no finite slope"
    return ""


def has_pole(term: AnyTerm, z: np.ndarray, v: np.ndarray, u: np.ndarray | None) -> bool:
    """Whether a term grows without bound between samples, which are finite themselves.

    1/z of a motion through zero is finite at every sample, and says nothing but how near to zero
    the nearest of them happens to be.
    """
    last = len(z) - 1
    sizes = np.abs(term.values(z, v, u))
    peaks = np.flatnonzero(
        (sizes >= np.append(sizes[1:], 0.0)) & (sizes >= np.insert(sizes[:-1], 0, 0.0))
    )
    peaks = peaks[np.argsort(sizes[peaks])[-_PEAKS:]]
    # A term that is zero at a peak, as one of a contact away from it, has grown by nothing there.
    usual = np.median(sizes[sizes > 0.0]) if sizes.any() else 1.0
    before = np.maximum(sizes[peaks], usual)
    centres, half = peaks.astype(float), 1.0
    first, end = np.clip((centres[:, None] - 1.0, centres[:, None] + 1.0), 0.0, float(last))
    places = np.arange(last + 1.0)
    greatest = before
    for _ in range(_ZOOMS):
        near = np.clip(centres[:, None] + half * _GRID, first, end)
        along = [None if each is None else np.interp(near, places, each) for each in (z, v, u)]
        found = np.abs(term.values(along[0], along[1], along[2]))  # type: ignore[arg-type]  # z, v
        if not np.isfinite(found).all():
            return True
        best = found.argmax(axis=1)
        rows = np.arange(len(peaks))
        centres, greatest = near[rows, best], np.maximum(greatest, found[rows, best])
        half /= 8.0
    return bool((greatest > _POLE * before).any())


def _slopes(motion: SmoothedMotion, term: AnyTerm) -> list[np.ndarray]:
    """The derivatives by which the record's noise enters the term's integrals."""
    if term.total:
        return [term.by_primitive(motion.z)]
    if term.still:
        return [np.asarray(term.by_height(motion.z, motion.velocity, motion.drive))]
    if not term.moving:
        return []
    here = motion.smooth, motion.velocity, motion.drive
    return [np.asarray(term.by_speed(*here)), np.asarray(term.by_height(*here))]
