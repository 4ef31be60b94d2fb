"""Vibration: spectra of gyro and accelerometer, their lines, and notch filters for them."""
