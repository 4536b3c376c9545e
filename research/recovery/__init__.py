"""Do fits reach the true optimum? Thirteen made systems, with noise, beside SciPy."""
