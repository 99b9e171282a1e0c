"""How soon the page shows what breaks, and how many pictures a second it hands out."""
