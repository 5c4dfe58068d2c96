"""The protocols, one file each: see voile.validate.protocol. Files whose name starts with an underscore are none."""
