"""Kinds of virtual sensors."""
