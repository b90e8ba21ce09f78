"""The case studies of Lacevic & Rocco (2013), run again: what bench/paper.py is made of."""
