"""Studies, in which many variations of one scene are simulated."""
