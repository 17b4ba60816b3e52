#!/usr/bin/env python3
"""Times GTSAM on pose graphs, from the start that `waypost-eval posegraph --start odometry` has.

    python3 -m venv venv && venv/bin/pip install gtsam numpy
    taskset -c 0 venv/bin/python eval/gtsam_posegraph.py FILE.g2o ...          # with --json: a line of JSON

Levenberg-Marquardt with default parameters, `optimize()` alone, median of ten. `cost` is what GTSAM minimises, twice
its error. `cost_g2o` is what the poses that it ends at cost by g2o's definition, which `waypost-eval posegraph`
minimises: in the plane an error's translation is that of the pose itself and not of its logarithm; in space its
angle is the sine of half the angle.
"""

import importlib.metadata
import json
import statistics
import sys
import time

import gtsam
import numpy

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


def cost_g2o(graph, poses, spatial):
    """The sum of eᵀΩe in g2o's convention."""
    at = poses.atPose3 if spatial else poses.atPose2
    total = 0.0
    for i in range(graph.size()):
        factor = graph.at(i)
        if not hasattr(factor, "measured"):
            continue  # what holds the first pose
        first, second = factor.keys()
        off = factor.measured().inverse().compose(at(first).between(at(second)))
        if spatial:
            turn = off.rotation().toQuaternion()
            sign = 1.0 if turn.w() >= 0 else -1.0
            # GTSAM has rotations before translations.
            error = numpy.array([sign * turn.x(), sign * turn.y(), sign * turn.z(), *off.translation()])
        else:
            error = numpy.array([off.x(), off.y(), off.theta()])
        total += error @ factor.noiseModel().information() @ error
    return total


def main():
    paths = [argument for argument in sys.argv[1:] if argument != "--json"]
    reports = [of_graph(path) for path in paths]
    if len(paths) < len(sys.argv) - 1:
        print(json.dumps({"version": importlib.metadata.version("gtsam"), "graphs": reports}))
        return
    print("graph,poses,edges,cost,cost_g2o,iterations,ms")
    for report in reports:
        print(
            "{graph},{poses},{edges},{cost:.6f},{cost_g2o:.6f},{iterations},{ms:.1f}".format(**report)
        )


def of_graph(path):
    """What became of one file's graph."""
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
    return {
        "graph": path.rsplit("/", 1)[-1],
        "poses": start.size(),
        "edges": edges,
        "cost": 2 * graph.error(poses),
        "cost_g2o": cost_g2o(graph, poses, spatial),
        "iterations": optimizer.iterations(),
        "ms": statistics.median(times),
    }


if __name__ == "__main__":
    main()
