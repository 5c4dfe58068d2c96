"""Obstacles, contact of shells with them, and Coulomb's law."""

from voile.contact.law import friction_error

__all__ = ["friction_error"]
