"""What temperature is in a bed, and what its defects have to do with forces and slip."""
