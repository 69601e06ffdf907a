"""From a pyramid to files: what each engine expects, EXR masters, pictures, and the manifest."""
