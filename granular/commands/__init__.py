"""Commands of ``python -m granular``, and the options that all packages' commands share."""
