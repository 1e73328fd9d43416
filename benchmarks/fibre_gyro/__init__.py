"""The fibre gyro: the simulated loop beside its laws, coverage of stated uncertainties, noise model."""
