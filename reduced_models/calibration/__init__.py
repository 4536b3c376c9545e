"""Numbers of a scene from a lab record, by fitting simulations to it."""
