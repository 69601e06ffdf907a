"""From the records of a comparison to one HTML file; nothing is baked or rendered here."""
