"""Parts as one buys and measures them: magnets, liquids, films and plates, by closed forms in SI."""
