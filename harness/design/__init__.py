"""Designing a rig: what range errors to expect of it, by cause, without rendering anything."""
