"""Laws with their parameters: what a fit or a discovery gives back."""
