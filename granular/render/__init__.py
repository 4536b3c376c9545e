"""Stills and movies of a bed, with grains to scale, walls and piston.

>>> from granular.render import movie, save_picture, still
>>> save_picture(still("runs/light-piston", colour="force"), "bed.png")
>>> movie("runs/light-piston", "bed.mp4", colour="sides")

The available colourings are listed in `granular.render.picture.COLOURINGS`.
"""

from __future__ import annotations

from granular.render.movie import movie
from granular.render.picture import save_picture, still

__all__ = ["movie", "save_picture", "still"]
