"""How the pairs of grains are summed. The law of a pair itself stands in `granular.effects`."""
