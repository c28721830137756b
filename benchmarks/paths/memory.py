"""Work measured in a process of its own: CPU time, and how far memory rose above what was there before.

python -m paths.memory JOB '[SIZE, …]'      (from benchmarks/; prints a line of JSON)
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import time
from pathlib import Path

BENCHMARKS = Path(__file__).resolve().parents[1]
KIB = 1024 if sys.platform != "darwin" else 1  # of ru_maxrss


def measured_apart(job: str, arguments: list) -> dict[str, float]:
    """{"cpu_s", "peak_bytes"} of a job of `paths.jobs`, in a process of its own."""
    paths = os.pathsep.join([str(BENCHMARKS), str(BENCHMARKS.parent), os.environ.get("PYTHONPATH", "")])
    command = [sys.executable, "-m", "paths.memory", job, json.dumps(arguments)]
    done = subprocess.run(command, env=os.environ | {"PYTHONPATH": paths}, check=True, capture_output=True, text=True)
    return json.loads(done.stdout.splitlines()[-1])


def command_apart(command: list[str]) -> dict[str, float]:
    """{"cpu_s", "peak_bytes"} of a command, the processes it starts included in its CPU time."""
    # by a small process that has no other children, so that they are this command's
    script = (
        "import json, resource, subprocess, sys; subprocess.run(json.loads(sys.argv[1]), check=True, "
        "stdout=subprocess.DEVNULL); u = resource.getrusage(resource.RUSAGE_CHILDREN); "
        "print(json.dumps([u.ru_utime + u.ru_stime, u.ru_maxrss]))"
    )
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join([str(BENCHMARKS.parent), os.environ.get("PYTHONPATH", "")])
    }
    run = [sys.executable, "-c", script, json.dumps(command)]
    done = subprocess.run(run, check=True, capture_output=True, text=True, env=environment)
    cpu, peak = json.loads(done.stdout.splitlines()[-1])
    return {"cpu_s": cpu, "peak_bytes": peak * KIB}


def main() -> None:
    """Run a job twice over: a small one that compiles, then the one that counts."""
    from paths.jobs import JOBS

    prepare = JOBS[sys.argv[1]]
    warm, work = prepare(*json.loads(sys.argv[2]))
    warm()
    forget_peak()
    before = peak_bytes()
    begun = time.process_time()
    work()
    cpu = time.process_time() - begun
    print(json.dumps({"cpu_s": cpu, "peak_bytes": peak_bytes() - before, "before_bytes": before}))


def forget_peak() -> None:
    """Let the peak begin at what is in memory now, where the system can (Linux)."""
    if Path("/proc/self/clear_refs").exists():
        Path("/proc/self/clear_refs").write_text("5")


def peak_bytes() -> int:
    """Most memory of this process so far.

    On Linux not `ru_maxrss`, which begins at what the process had that started this one.
    """
    status = Path("/proc/self/status")
    if status.exists():
        return KIB * int(status.read_text().split("VmHWM:")[1].split()[0])
    return KIB * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


if __name__ == "__main__":
    main()
