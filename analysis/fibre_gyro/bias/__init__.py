"""What lies below the scale factor: small rates, the bias and K over the temperature, switching on."""
