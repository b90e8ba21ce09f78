"""`lanes.pyx`, compiled for processors with AVX2."""

include "lanes.pyx"
