from .depth_errors import Errors as Errors
from .depth_errors import angle_between as angle_between
from .depth_errors import compare as compare
from .depth_errors import occlusion_cuts as occlusion_cuts
from .depth_errors import resampled_truth as resampled_truth
from .mesh_distance import SurfaceDistance as SurfaceDistance
from .mesh_distance import distance_to as distance_to
from .mesh_distance import to_open3d as to_open3d
