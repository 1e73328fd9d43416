"""The paper's simulations beside the exact method."""
