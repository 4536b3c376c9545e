"""How often `discover` finds a law: fourteen made systems, with noise, beside two peers."""
