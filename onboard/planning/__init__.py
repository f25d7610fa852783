"""Local graph, volumetric gain, best path, global graph, deployment, regrouping."""
