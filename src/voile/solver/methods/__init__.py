"""Methods that find one equilibrium, each with a SNES and an option prefix of its own."""
