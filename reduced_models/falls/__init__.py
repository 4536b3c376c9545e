"""Whole falls: laws fitted to one fall of a piston, judged on falls that no fit has seen.

>>> from reduced_models import score_drops, predict
>>> law = predict(scene)  # from the scene alone
>>> falls = score_drops(fall, unseen, scene=scene)  # from one fall
"""
