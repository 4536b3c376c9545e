"""The main job: from a scene, a run or a lab record to its equation, judged and written down."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
