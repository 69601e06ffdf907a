"""Material files."""
SUFFIXES = (".gltf", ".glb", ".mtlx")
