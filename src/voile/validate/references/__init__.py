"""References that need a computation of their own: boundary value problems, closed forms."""
