"""Stills and movies of the bed: grains at their true size, walls and piston.

>>> from granular.render import movie, save_picture, still
>>> save_picture(still("runs/light-piston", colour="force"), "bed.png")
>>> movie("runs/light-piston", "bed.mp4", colour="sides")

The colours are those of `granular.render.picture.COLOURINGS`.
"""

from __future__ import annotations

from granular.render.movie import movie
from granular.render.picture import save_picture, still

__all__ = ["movie", "save_picture", "still"]
