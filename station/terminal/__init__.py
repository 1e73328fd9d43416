"""What is shown: it may fail without harming what is measured, and nobody gets in through it."""
