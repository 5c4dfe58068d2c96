"""Studies: a scene in many variants, what each costs, how far it is off, and which to choose."""
