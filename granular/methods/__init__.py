"""Built-in and user-defined integration methods, which are tables of coefficients."""

from granular.methods.method import Method
from granular.methods.tables import METHODS, method_named, resolve_method

__all__ = ["METHODS", "Method", "method_named", "resolve_method"]
