"""Melting of a layer of dipoles under a bath: where order is lost, beside published values."""
