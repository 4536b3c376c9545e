"""Draw the pictures of the README and the guide anew: ``python docs/pictures.py``."""

from __future__ import annotations

from pathlib import Path

from granular import Trajectory, damper, mono_bed, simulate
from granular.render import save, still
from granular.shared.plotting import COLOURS, GREY, figure
from reduced_models import damper_maps, fit
from reduced_models.designs.page import plot_maps

IMAGES = Path(__file__).parent / "images"
DIAMETER = 0.006


def draw_fall(run: Trajectory) -> None:
    """The fall, and the swing after the lift with the law fitted to its first two thirds."""
    drop, swing = run.piston("drop").from_zero(), run.piston("release").from_zero()
    seen = swing.between(0.0, 4.0)
    model = fit(seen, law="polynomial-spring", holdout=0.0)
    predicted = model.simulate(swing.time)
    with figure(1, 2, width=9.0, height=3.0) as (drawing, (left, right)):
        left.plot(drop.time, drop.height / DIAMETER, color=COLOURS[0])
        left.set(xlabel="time [s]", ylabel="height of the piston [D]", xlim=(0.0, 4.0))
        left.set_title("the fall from 20 D", fontsize=10)
        right.plot(swing.time, swing.height / DIAMETER, color=GREY, linewidth=3, label="simulated")
        right.plot(swing.time, predicted.height / DIAMETER, color=COLOURS[1], linewidth=1,
                   label="its equation")  # fmt: skip
        right.axvline(seen.time[-1], color=GREY, linestyle=":")
        right.set(xlabel="time [s]", xlim=(0.0, 6.0))
        right.set_title("lifted by 0.2 D and released; fitted left of the dots", fontsize=10)
        right.legend()
        save(drawing, IMAGES / "fall.png", overwrite=True)


def draw_compression() -> None:
    """Voronoi cells of a bed at full compression."""
    scene = mono_bed(368, speed=33e-3, relaxation=1.0)
    stages = scene.to_plain()["protocol"][:2]
    run = simulate(scene.replace(protocol=stages))
    save(still(run, -1, colour="sides"), IMAGES / "compressed.png", overwrite=True)


def main() -> None:
    """Draw all pictures."""
    IMAGES.mkdir(exist_ok=True)
    run = simulate(damper())
    save(still(run, 2, colour="speed"), IMAGES / "damper.png", overwrite=True)
    draw_fall(run)
    draw_compression()
    save(plot_maps(damper_maps()), IMAGES / "maps.png", overwrite=True)


if __name__ == "__main__":
    main()
