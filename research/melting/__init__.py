"""Melting of a layer of dipoles in a heat bath: loss of orientational and translational order."""
