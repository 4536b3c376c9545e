"""Melting of a layer of dipoles under a bath: where its order is lost."""
