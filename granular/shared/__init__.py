"""Shared by all three packages: errors and their words, files, pages, pictures, tables, stops."""
