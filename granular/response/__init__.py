"""What is left of a machine's vibration: a host's response to what shakes it, with its damper."""
