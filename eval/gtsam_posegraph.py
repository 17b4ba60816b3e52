#!/usr/bin/env python3
"""Times GTSAM on pose graphs, from the start that `waypost-eval posegraph --start odometry` has.

    python3 -m venv venv && venv/bin/pip install gtsam numpy
    taskset -c 0 venv/bin/python eval/gtsam_posegraph.py FILE.g2o ...

Levenberg-Marquardt with default parameters, `optimize()` alone, median of ten. The cost is twice GTSAM's error;
in three dimensions its error has the whole angle where g2o's has the sine of half of it, so only times compare.
"""

import statistics
import sys
import time

import gtsam

REPEATS = 10


def along_odometry(graph, spatial):
    """Poses chained along edges from each id to the next, from the lowest on."""
    steps = {}
    for i in range(graph.size()):
        factor = graph.at(i)
        first, second = factor.keys()
        steps.setdefault((first, second), factor.measured())
    keys = sorted({key for edge in steps for key in edge})
    poses = gtsam.Values()
    pose = gtsam.Pose3() if spatial else gtsam.Pose2()
    poses.insert(keys[0], pose)
    for first, second in zip(keys, keys[1:]):
        pose = pose.compose(steps[first, second])
        poses.insert(second, pose)
    return keys[0], poses


def main():
    print("graph,poses,edges,cost,iterations,ms")
    for path in sys.argv[1:]:
        with open(path, encoding="utf-8") as lines:
            spatial = any(line.startswith("EDGE_SE3:QUAT") for line in lines)
        graph, _ = gtsam.readG2o(path, spatial)
        lowest, start = along_odometry(graph, spatial)
        edges = graph.size()
        if spatial:
            graph.add(gtsam.NonlinearEqualityPose3(lowest, start.atPose3(lowest)))
        else:
            graph.add(gtsam.NonlinearEqualityPose2(lowest, start.atPose2(lowest)))
        times = []
        for _ in range(REPEATS):
            optimizer = gtsam.LevenbergMarquardtOptimizer(graph, start, gtsam.LevenbergMarquardtParams())
            began = time.perf_counter()
            poses = optimizer.optimize()
            times.append(1e3 * (time.perf_counter() - began))
        cost, name = 2 * graph.error(poses), path.rsplit("/", 1)[-1]
        ms = statistics.median(times)
        print(f"{name},{start.size()},{edges},{cost:.6f},{optimizer.iterations()},{ms:.1f}", flush=True)


if __name__ == "__main__":
    main()
