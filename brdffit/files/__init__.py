"""Files: images through OpenImageIO, and writes that happen whole or not at all."""
