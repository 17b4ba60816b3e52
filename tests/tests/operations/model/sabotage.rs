//! What a server might get wrong when it starts again, done to its database in its place: the model has to find it.

use std::path::Path;

use sqlx::{ConnectOptions, Connection};

use crate::harness::database_options;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Sabotage {
    /// A label is not there any more.
    ForgetsALabel,
    /// The last frame of a map, if it is the last event there, was answered and is lost.
    LosesTheLastFrame,
    /// A session is of nobody.
    ForgetsWhoseASessionIs,
    /// A token that may only look may stream.
    LetsALookerWrite,
}

impl Sabotage {
    pub(super) const ALL: [Self; 4] =
        [Self::ForgetsALabel, Self::LosesTheLastFrame, Self::ForgetsWhoseASessionIs, Self::LetsALookerWrite];

    pub(super) async fn commit(self, data: &Path) {
        let change = match self {
            Self::ForgetsALabel => {
                "DELETE FROM labels WHERE (map_id, place) = \
                 (SELECT map_id, place FROM labels ORDER BY map_id DESC LIMIT 1)"
            }
            Self::LosesTheLastFrame => {
                "DELETE FROM log WHERE sequence IS NOT NULL AND (map_id, position) = \
                 (SELECT map_id, max(position) FROM log GROUP BY map_id ORDER BY map_id DESC LIMIT 1)"
            }
            Self::ForgetsWhoseASessionIs => {
                "UPDATE sessions SET owner = NULL WHERE owner LIKE 't%' AND rowid = \
                 (SELECT max(rowid) FROM sessions WHERE owner LIKE 't%')"
            }
            Self::LetsALookerWrite => {
                "UPDATE tokens SET abilities = 'read,localize,stream' WHERE abilities = 'read,localize'"
            }
        };
        let mut database = database_options(data).connect().await.unwrap();
        sqlx::query(change).execute(&mut database).await.unwrap();
        database.close().await.unwrap();
    }
}
