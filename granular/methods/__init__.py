"""Integration methods: built-in tables, and user-defined methods of the same class."""

from granular.methods.method import Method
from granular.methods.tables import METHODS, method_named, resolve_method

__all__ = ["METHODS", "Method", "method_named", "resolve_method"]
