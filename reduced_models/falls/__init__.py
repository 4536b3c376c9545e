"""Whole falls: laws fitted to one fall of a piston and tested on held-out falls.

>>> from reduced_models import score_drops, predict
>>> law = predict(scene)  # from the scene alone
>>> falls = score_drops(fall, unseen, scene=scene)  # from one fall
"""
