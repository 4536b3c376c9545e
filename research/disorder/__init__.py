"""Temperature of a bed, and the relation of its defects to forces and slip."""
