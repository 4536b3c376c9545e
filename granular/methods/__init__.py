"""Integration methods: the built-in tables, and a user's own as an object of the same class."""

from granular.methods.method import Method
from granular.methods.registry import method_named, resolve_method
from granular.methods.tables import METHODS

__all__ = ["METHODS", "Method", "method_named", "resolve_method"]
