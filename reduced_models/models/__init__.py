"""Models: laws with fitted parameters, as returned by a fit or a discovery."""
