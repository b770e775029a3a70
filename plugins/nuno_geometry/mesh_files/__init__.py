"""Files of meshes and arrays: OBJ, PLY, STL, GLB and NPZ."""
