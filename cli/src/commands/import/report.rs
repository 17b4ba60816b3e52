//! What came of an import: the sessions, and how both maps compare.

use std::io::{self, Write};

use serde::Serialize;
use waypost_bags::rtabmap::{ClosureKind, RtabMap};
use waypost_client::Client;

use super::closures::{Closures, Index, Nodes, Rule, compare};
use super::sessions::Imported;
use super::trajectory::{Apart, Trajectory, trajectory};
use crate::failure::Failure;
use crate::names::short_map;
use crate::output::rounded;
use crate::rtab_drive::remarks;

/// Pairs of nodes that are named in text; `--json` has all.
const MOST_NAMED: usize = 12;

/// What `--json` prints.
#[derive(Serialize)]
pub(super) struct Report {
    database: String,
    /// The version of RTAB-Map that made the schema.
    rtabmap: String,
    map: String,
    sessions: Vec<Imported>,
    closures: Closures,
    /// How many closures RTAB-Map has of each kind.
    theirs_by_kind: Kinds,
    /// Of sessions whose poses RTAB-Map optimised.
    trajectories: Vec<Trajectory>,
    /// What was left out, or is not as it should be, a sentence each.
    remarks: Vec<String>,
}

#[derive(Serialize)]
struct Kinds {
    global: usize,
    nearby: usize,
    user: usize,
}

impl Report {
    pub(super) async fn of(
        client: &Client,
        rtabmap: &RtabMap,
        map: &str,
        sessions: Vec<Imported>,
        rule: Rule,
    ) -> Result<Self, Failure> {
        let named = sessions.iter().map(|imported| (imported.session.clone(), imported.index));
        let index = Index::new(rtabmap, named);
        let ours = client.loop_closures(map).await?;
        let mut trajectories = Vec::new();
        for imported in &sessions {
            let session = &rtabmap.sessions()[imported.index];
            trajectories.extend(trajectory(client, &imported.session, session, rtabmap.optimized()).await?);
        }
        let count = |kind| rtabmap.closures().iter().filter(|closure| closure.kind == kind).count();
        Ok(Self {
            database: rtabmap.path().display().to_string(),
            rtabmap: rtabmap.version().to_owned(),
            map: format!("maps/{}", short_map(map)),
            sessions,
            closures: compare(rtabmap, &index, &ours, rule),
            theirs_by_kind: Kinds {
                global: count(ClosureKind::Global),
                nearby: count(ClosureKind::Nearby),
                user: count(ClosureKind::User),
            },
            trajectories,
            remarks: remarks(rtabmap),
        })
    }

    /// How many frames were refused.
    pub(super) fn refused(&self) -> usize {
        self.sessions.iter().map(|imported| imported.refused).sum()
    }

    pub(super) fn write(&self, out: &mut dyn Write) -> io::Result<()> {
        let frames: usize = self.sessions.iter().map(|imported| imported.frames).sum();
        let answered: usize = self.sessions.iter().map(|imported| imported.answered).sum();
        writeln!(out, "{:<41}{:6}", "sessions", self.sessions.len())?;
        writeln!(out, "{:<41}{frames:6}", "frames")?;
        writeln!(out, "  {:<39}{answered:6}", "answered now")?;
        writeln!(out, "  {:<39}{:6}", "refused", self.refused())?;
        self.write_closures(out)?;
        self.trajectories.iter().try_for_each(|trajectory| write_trajectory(trajectory, out))?;
        if self.trajectories.is_empty() {
            writeln!(
                out,
                "no trajectory is compared: RTAB-Map kept no optimised poses of three frames of a session"
            )?;
        }
        Ok(())
    }

    fn write_closures(&self, out: &mut dyn Write) -> io::Result<()> {
        let Closures {
            within_nodes,
            theirs_found,
            theirs_only,
            theirs_only_within_guard,
            theirs_without_frames,
            ours_found,
            ours_only,
        } = &self.closures;
        let Kinds { global, nearby, user } = self.theirs_by_kind;
        writeln!(out, "{:<41}{:6}", "loop closures of RTAB-Map", global + nearby + user)?;
        for (what, count) in [
            ("found by the map too", theirs_found.len()),
            ("not found by the map", theirs_only.len()),
            ("  of these, too near in their drive", *theirs_only_within_guard),
            ("of nodes without images, not compared", *theirs_without_frames),
        ] {
            writeln!(out, "  {what:<39}{count:6}")?;
        }
        writeln!(out, "{:<41}{:6}", "loop closures of the map", ours_found.len() + ours_only.len())?;
        writeln!(out, "  {:<39}{:6}", "found by RTAB-Map too", ours_found.len())?;
        writeln!(out, "  {:<39}{:6}", "not found by RTAB-Map", ours_only.len())?;
        writeln!(out, "two closures are the same if both ends are at most {within_nodes} nodes apart")?;
        write_nodes("only RTAB-Map's", theirs_only, out)?;
        write_nodes("only the map's", ours_only, out)
    }
}

fn write_nodes(whose: &str, nodes: &[Nodes], out: &mut dyn Write) -> io::Result<()> {
    if nodes.is_empty() {
        return Ok(());
    }
    let named = nodes.iter().take(MOST_NAMED).map(|Nodes { node, matched_node, kind }| {
        let kind = kind.map_or_else(String::new, |kind| format!(" {kind}"));
        format!("{node}–{matched_node}{kind}")
    });
    let named: Vec<String> = named.collect();
    let more = match nodes.len() - named.len() {
        0 => String::new(),
        more => format!(", and {more} more, which --json lists"),
    };
    writeln!(out, "{whose}, by nodes: {}{more}", named.join(", "))
}

fn write_trajectory(
    Trajectory { session, length_m, map, odometry }: &Trajectory,
    out: &mut dyn Write,
) -> io::Result<()> {
    let id = session.rsplit('/').next().unwrap_or_default();
    let length = rounded(*length_m, 1);
    let told = |apart: &Option<Apart>| match apart {
        Some(Apart { frames, rmse_m, largest_m }) => format!(
            "{} m apart (RMSE over {frames} frames), {} m at most",
            rounded(*rmse_m, 3),
            rounded(*largest_m, 3)
        ),
        None => "not known".to_owned(),
    };
    writeln!(out, "{id}, {length} m by RTAB-Map's optimised poses")?;
    writeln!(out, "  {:<25}{}", "the map's trajectory is", told(map))?;
    writeln!(out, "  {:<25}{}", "odometry alone is", told(odometry))
}
