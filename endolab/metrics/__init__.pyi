from .coverage import Coverage as Coverage
from .coverage import coverage_of as coverage_of
from .depth_errors import Errors as Errors
from .depth_errors import angle_between as angle_between
from .depth_errors import compare as compare
from .depth_errors import depth_cuts as depth_cuts
from .depth_errors import resample_truth as resample_truth
from .open3d_mesh import to_open3d as to_open3d
