"""Which runs of places hold the partners of which grains, in the stripes of a periodic cell.

As in `granular.pairs.stripe_lists`, but for the images of the partners on both sides, and of the
lowest stripes above the highest ones: each run has a shift, by which its partners stand away from
the places that they have within the cell. There are four stripes or more, and twice the reach is
less than the cell is wide and high, so that each pair is met once.
"""

from __future__ import annotations

import math

from granular.compiled import compiled
from granular.pairs.lanes import WIDTH
from granular.pairs.runs import IMAGES, ROWS, RUNS
from granular.pairs.stripe_sort import PADDING
from granular.pairs.stripes import Stripes

_HERE, _RIGHT, _LEFT = range(IMAGES)


@compiled
def list_images(stripes: Stripes, number: int, reach: float) -> None:
    """List the runs of every two rows, and their shifts."""
    far = reach * (1.0 + 1e-12)
    for k in range(number):
        for up in range(RUNS):
            there, turns = (k + up) % number, (k + up) // number
            for image in range(IMAGES):
                _list_images_of(stripes, k, there, turns, up, image, far)


@compiled
def _list_images_of(
    stripes: Stripes, k: int, there: int, turns: int, up: int, image: int, far: float
) -> None:
    """List one image of the partners of a stripe's rows, in itself or in one above."""
    x, y, runs, periods, shifts = (
        stripes.x, stripes.y, stripes.runs, stripes.periods, stripes.shifts
    )  # fmt: skip
    assert periods is not None
    assert shifts is not None
    across = periods[0] * ((image == _RIGHT) - (image == _LEFT))
    rise, run = periods[1] * turns, IMAGES * up + image
    begin = stripes.begins[there]
    end, lowest = begin, math.inf
    while end < stripes.begins[there + 1] and x[end] < PADDING:
        lowest = min(lowest, y[end] + rise)
        end += 1
    start, stop = begin, begin
    for first in range(stripes.begins[k], stripes.begins[k + 1], ROWS):
        pair = first // ROWS
        runs[pair, run, 0] = runs[pair, run, 1] = 0
        shifts[pair, run, 0], shifts[pair, run, 1] = across, rise
        # In its own stripe a grain meets those behind it, the images on the right among them.
        if x[first] < PADDING and not (up == 0 and image == _LEFT):
            two = x[first + 1] < PADDING
            left, right = x[first] - across, (x[first + 1] if two else x[first]) - across
            apart = lowest - (max(y[first], y[first + 1]) if two else y[first])
            wide = far if up == 0 else math.sqrt(max(far * far - max(apart, 0.0) ** 2, 0.0))
            while start > begin and x[start - 1] >= left - wide:
                start -= 1
            while start < end and x[start] < left - wide:
                start += 1
            while stop > begin and x[stop - 1] > right + wide:
                stop -= 1
            while stop < end and x[stop] <= right + wide:
                stop += 1
            if apart < far or up == 0:
                # The seven behind the second row are met with it.
                own = up == 0 and image == _HERE
                runs[pair, run, 0] = first + 1 + WIDTH if own else start
                runs[pair, run, 1] = stop
