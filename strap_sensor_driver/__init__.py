"""The instrument: strap geometry, frames, clock, contact zone, and the reader that turns bytes into angles."""
