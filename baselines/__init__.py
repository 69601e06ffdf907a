"""Classical methods to make MIP levels of a material, one file each; brdffit finds them by entry points."""
