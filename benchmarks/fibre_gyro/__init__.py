"""The fibre gyro: the simulated loop beside its laws, the coverage of stated uncertainties, damaged frames, Allan."""
