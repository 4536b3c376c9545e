"""The engine: one compiled loop, specialised to the effects that a scene names."""
