"""The servers of a database."""

from __future__ import annotations

from waypost.connection import Connection
from waypost.v1 import cluster_pb2


class ClusterCalls:
    """Which servers there are; for administrators of the whole server."""

    _connection: Connection

    def cluster(self) -> cluster_pb2.Cluster:
        """The servers of the database, which of them owns it, and how they and the database's standbys do.

        Whichever server is asked, the owner answers. For administrators of the whole server.

        Raises:
            PermissionDenied: If the token is for less than that.
        """
        cluster: cluster_pb2.Cluster = self._connection.call(
            self._connection.cluster.GetCluster, cluster_pb2.GetClusterRequest()
        )
        return cluster
