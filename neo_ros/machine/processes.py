"""Processes of a ROS graph that a measurement or the demo started."""
import signal
import subprocess

GRACE_S = 10.0


def end_process(process: subprocess.Popen) -> None:
    """Interrupt a process as Ctrl-C would, and kill it if it does not end."""
    process.send_signal(signal.SIGINT)
    try:
        process.wait(GRACE_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
