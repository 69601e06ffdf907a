"""From records of a comparison to one HTML file: it draws, it computes nothing."""
