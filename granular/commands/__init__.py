"""The commands of ``python -m granular``, one file each: its help, its options, what it does."""
