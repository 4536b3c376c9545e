"""The scene: a frozen, validated, plain description of a bed, its piston and its protocol."""
