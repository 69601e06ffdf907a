"""What accuracy costs in time: all settings and methods, on the same texels in the same run."""
