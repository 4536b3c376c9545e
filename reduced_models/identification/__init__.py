"""The main job: from a scene, a run or a lab record to its equation, tested and reported."""
