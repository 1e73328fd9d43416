"""The geometric series of harmonics, fitted to the samples."""
