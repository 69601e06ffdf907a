"""What accuracy costs in time: everything that can be chosen, on the same texels in the same run."""
