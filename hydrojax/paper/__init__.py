"""The paper's reference rig, its experiments and its figures."""
