"""Calibration files as the tools write them; numbers made up, but of the size of real ones."""

from pathlib import Path

OMNIDIR_YAML = """\
%YAML:1.0
---
calibration_time: "Thu Nov 26 2026"
image_width: 1024
image_height: 768
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 2.8223938294331566e+02, 5.0000000000000000e-01,
       5.1539853520931602e+02, 0., 2.8315607125000002e+02,
       3.8473989403309110e+02, 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 1
   cols: 4
   dt: d
   data: [ 7.7531333953325700e-02, 2.7664400596417553e-02,
       1.3229517533848763e-03, 1e-05 ]
xi: 1.1436422518426306e+00
rms: 0.33
"""

OMNIDIR_XML = """\
<?xml version="1.0"?>
<opencv_storage>
<image_width>1024</image_width>
<image_height>768</image_height>
<camera_matrix type_id="opencv-matrix">
  <rows>3</rows>
  <cols>3</cols>
  <dt>d</dt>
  <data>
    2.8223938294331566e+002 5.0000000000000000e-001 5.1539853520931602e+002 0.
    2.8315607125000002e+002 3.8473989403309110e+002 0. 0. 1.</data></camera_matrix>
<distortion_coefficients type_id="opencv-matrix">
  <rows>1</rows>
  <cols>4</cols>
  <dt>d</dt>
  <data>
    7.7531333953325700e-002 2.7664400596417553e-002 1.3229517533848763e-003
    1e-005</data></distortion_coefficients>
<xi type_id="opencv-matrix">
  <rows>1</rows>
  <cols>1</cols>
  <dt>d</dt>
  <data>
    1.1436422518426306e+000</data></xi>
</opencv_storage>
"""

FISHEYE_YAML = """\
%YAML:1.0
---
image_width: 1600
image_height: 1200
fisheye_model: 1
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 4.0123e+02, 0., 8.0312e+02, 0., 4.0098e+02, 5.9877e+02, 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 4
   cols: 1
   dt: d
   data: [ -1.3e-02, 4.1e-03, -2.3e-03, 3.1e-04 ]
"""

ROS_CAMERA_INFO = """\
image_width: 640
image_height: 480
camera_name: front
camera_matrix:
  rows: 3
  cols: 3
  data: [420.5, 0, 318.2, 0, 421.5, 242.9, 0, 0, 1]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [-0.28, 0.07, 0.0009, 0.0001, -0.006]
rectification_matrix:
  rows: 3
  cols: 3
  data: [1, 0, 0, 0, 1, 0, 0, 0, 1]
"""

KALIBR = """\
cam0:
  cam_overlaps: [1, 2, 3]
  camera_model: omni
  distortion_coeffs: [-0.21, 0.13, 0.0006, -0.0004]
  distortion_model: radtan
  intrinsics: [1.45, 833.0, 830.3, 373.9, 253.7]
  resolution: [752, 480]
  rostopic: /cam0/image_raw
cam1:
  T_cn_cnm1:
  - [0.0, -1.0, 0.0, 0.1]
  - [1.0, 0.0, 0.0, 0.2]
  - [0.0, 0.0, 1.0, 0.3]
  - [0.0, 0.0, 0.0, 1.0]
  camera_model: ds
  distortion_coeffs: []
  distortion_model: none
  intrinsics: [-0.18, 0.59, 158.2, 158.4, 255.0, 256.1]
  resolution: [512, 512]
cam2:
  T_cn_cnm1:
  - [1.0, 0.0, 0.0, -0.5]
  - [0.0, 1.0, 0.0, 0.0]
  - [0.0, 0.0, 1.0, 0.0]
  - [0.0, 0.0, 0.0, 1.0]
  camera_model: eucm
  distortion_coeffs: []
  distortion_model: none
  intrinsics: [0.63, 1.04, 461.6, 460.2, 362.7, 246.0]
  resolution: [752, 480]
cam3:
  T_cn_cnm1:
  - [1.0, 0.0, 0.0, 0.0]
  - [0.0, 1.0, 0.0, 0.0]
  - [0.0, 0.0, 1.0, 0.0]
  - [0.0, 0.0, 0.0, 1.0]
  camera_model: pinhole
  distortion_coeffs: [-0.0131, 0.0501, -0.0451, 0.0124]
  distortion_model: equidistant
  intrinsics: [190.9, 190.8, 254.9, 256.9]
  resolution: [512, 512]
"""

CAMODOCAL = """\
%YAML:1.0
---
model_type: MEI
camera_name: camera
image_width: 1280
image_height: 1024
mirror_parameters:
   xi: 2.2134047507854890e+00
distortion_parameters:
   k1: 1.6798235660113681e-02
   k2: 1.6548773243373522e+00
   p1: 4.2223943394772046e-04
   p2: 4.2462134260997584e-04
projection_parameters:
   gamma1: 1.3363220825849971e+03
   gamma2: 1.3357883350012958e+03
   u0: 7.1694323510126321e+02
   v0: 5.0576421000000002e+02
"""

OCAMCALIB = """\
#polynomial coefficients for the DIRECT mapping function (ocam_model.ss in MATLAB). These are used by cam2world

5 -2.190000e+02 0.000000e+00 1.900000e-03 -3.100000e-06 1.200000e-08

#polynomial coefficients for the inverse mapping function (ocam_model.invpol in MATLAB). These are used by world2cam

6 320.255 174.57 -12.269 26.023 21.159 4.547

#center: "row" and "column", starting from 0 (C convention)

241.019976 385.783141

#affine parameters "c", "d", "e"

0.998881 -0.002038 0.003079

#image size: "height" and "width"

480 748

"""

BASALT = """\
{
    "value0": {
        "T_imu_cam": [
            {"px": 0.1, "py": 0.0, "pz": 0.0, "qx": 0.0, "qy": 0.0, "qz": 0.0, "qw": 1.0},
            {"px": 0.0, "py": 0.2, "pz": 0.0, "qx": 0.0, "qy": 0.0, "qz": 0.7071067811865476, "qw": 0.7071067811865476},
            {"px": 0.0, "py": 0.0, "pz": 0.0, "qx": 0.0, "qy": 0.0, "qz": 0.0, "qw": 1.0},
            {"px": 0.0, "py": 0.0, "pz": 0.0, "qx": 0.0, "qy": 0.0, "qz": 0.0, "qw": 1.0}
        ],
        "intrinsics": [
            {"camera_type": "ds", "intrinsics":
                {"fx": 158.2, "fy": 158.4, "cx": 255.0, "cy": 256.1, "xi": -0.18, "alpha": 0.59}},
            {"camera_type": "kb4", "intrinsics":
                {"fx": 190.9, "fy": 190.8, "cx": 254.9, "cy": 256.9,
                 "k1": 0.0034, "k2": 0.0007, "k3": -0.002, "k4": 0.0002}},
            {"camera_type": "eucm", "intrinsics":
                {"fx": 190.4, "fy": 190.5, "cx": 253.9, "cy": 257.9, "alpha": 0.63, "beta": 1.04}},
            {"camera_type": "ucm", "intrinsics":
                {"fx": 190.4, "fy": 190.5, "cx": 253.9, "cy": 257.9, "alpha": 0.6}}
        ],
        "resolution": [[512, 512], [512, 512], [512, 512], [512, 512]],
        "vignette": [],
        "imu_update_rate": 200.0
    }
}
"""

COLMAP = """\
# Camera list with one line of data per camera:
#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]
# Number of cameras: 4
1 OPENCV_FISHEYE 1600 1200 401.23 400.98 803.62 599.27 -0.013 0.0041 -0.0023 0.00031
2 EUCM 752 480 461.6 460.2 363.2 246.5 0.63 1.04
7 SIMPLE_RADIAL_FISHEYE 640 480 300 320 240 -0.02
9 OPENCV 640 480 420.5 421.5 318.7 243.4 -0.28 0.07 0.0009 0.0001
"""

OMNIMVS = """\
config: { omnimvs_sweep_min_depth: 0.5 }
cameras:
  - cam_id: 1
    model: ocam
    poly: [2, -300.0, 0.0]
    inv_poly: [13, 471.238898038469, 300.0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]
    center: [400.5, 500.25]
    affine: [1.001, -2.0E-4, 3.0e-4]
    image_size: [800, 1000]
    pose: [0.0, 0.0, 0.0, 0.1, 0.0, 0.0]
    max_fov: 200.0
  - cam_id: 2
    model: ocam
    poly: [3, -300.0, 0.0, 1.6666666666666668e-3]
    inv_poly: [2, 471.238898038469, 300.0]
    center: [399.5, 499.75]
    affine: [1, 0, 0]
    image_size: [800, 1000]
    pose: [0.0, 1.5707963267948966, 0.0, 0.1, 0.0, -0.2]
    max_fov: 160.0
"""
"""Two equidistant fisheyes by their inverse polynomials, r = 300 times the angle."""

ALL = {
    "omni.yaml": OMNIDIR_YAML,
    "omni.xml": OMNIDIR_XML,
    "fisheye.yml": FISHEYE_YAML,
    "ros.yaml": ROS_CAMERA_INFO,
    "camchain.yaml": KALIBR,
    "mei.yaml": CAMODOCAL,
    "calib_results.txt": OCAMCALIB,
    "calibration.json": BASALT,
    "cameras.txt": COLMAP,
    "rig.yaml": OMNIMVS,
}


def write(folder: Path, text: str, name: str = "file") -> Path:
    """A file whose name says nothing."""
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path
