"""Classical ways to make MIP levels of a material, one Method a file; brdffit finds them by entry points."""
