"""Scenes from files: the packaged ones by name, others by path."""

from __future__ import annotations

import os
from pathlib import Path

from granular.scene.scene import Scene
from granular.shared.errors import SceneError, quote, unknown_word_message
from granular.shared.files import read_toml

SCENES = Path(__file__).parents[1] / "scenes"


def scene_names() -> tuple[str, ...]:
    """Names of the packaged scenes.

    Returns
    -------
    tuple of str
        Names that `load_scene` takes, sorted.

    Examples
    --------
    >>> from granular import scene_names
    >>> scene_names()
    ('bed', 'damper', 'damper-source', 'machine', 'magnets', 'silo', 'single-particle', 'workshop')
    """
    return tuple(sorted(path.stem for path in SCENES.glob("*.toml")))


def load_scene(source: str | Path) -> Scene:
    """Return the packaged scene by its name, or a scene from a TOML file.

    Parameters
    ----------
    source : str or Path
        Name of a packaged scene (`scene_names`), or else path of a TOML file.

    Returns
    -------
    Scene
        The scene, validated.

    Raises
    ------
    SceneError
        If there is no such scene, the file cannot be read or is not TOML, or the scene is not valid.

    Examples
    --------
    >>> from granular import load_scene
    >>> scene = load_scene("damper").replace(**{"piston.mass": "6.5 kg"})
    >>> scene.piston.mass, scene.grains.count
    (6.5, 368)
    """
    path = Path(source)
    if str(source) in scene_names():
        path = SCENES / f"{source}.toml"
    elif not os.path.isfile(path):  # also of a name that no file can have
        if path.suffix:
            raise SceneError(f"there is no scene file {quote(str(source))}; check the path")
        raise SceneError(unknown_word_message(str(source), scene_names(), "scene"))
    plain = read_toml(path, SceneError)
    try:
        return Scene.from_plain(plain)
    except SceneError as error:
        raise SceneError(f"{path.name}: {error}") from None
