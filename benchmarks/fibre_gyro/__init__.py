"""The fibre gyro: the simulated loop beside its laws, the coverage of uncertainties, damaged frames, Allan."""
