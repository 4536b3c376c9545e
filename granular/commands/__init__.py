"""Commands of ``python -m granular``, and options shared by the commands of all packages."""
