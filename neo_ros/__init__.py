"""neo_ros widens a robot's camera view to what the scene really shows outside the frame."""
import os

__version__ = '0.1.0'

# The threads of parallel loops, numba's and torch's, wait for one another asleep. By default they
# burn their cores meanwhile: beside a few niced processes a guided image took 211 ms instead of
# 66. OpenMP reads this when it is loaded, so it stands before every other import.
os.environ.setdefault('OMP_WAIT_POLICY', 'passive')
# So do those of numpy's OpenBLAS. By default they watch for more work for 2 ** 26 cycles, 25 ms,
# after each product, which was a fifth of all that a guided image took. For 0.1 ms they may.
os.environ.setdefault('OPENBLAS_THREAD_TIMEOUT', '18')
# And those of OpenCV, whose workers look 2000 times for more work before they sleep.
os.environ.setdefault('OPENCV_THREAD_POOL_ACTIVE_WAIT_WORKER', '0')
