"""Identification: from a scene, a run or a lab record to a tested equation of motion and a report."""
