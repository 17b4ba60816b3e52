//! `kill -9` at a call of the disk, before it or in the middle of a write, during everything that a server writes.
//!
//! `WAYPOST_KILLS` is how many kills there are: see `long_runs`.

mod operations;
mod programs;
mod template;

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use futures::StreamExt;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use waypost_client::v1::job;

use super::on_a_thread;
use super::watched::{Calls, Fault, How, WatchedDisk, copy_below};
use crate::operations::long_runs::Tries;
use operations::{Broken, OPERATIONS, Operation};
use template::{OTHER, State, Template, rot, state};

/// Kills in every run of the tests.
const KILLS: u64 = 38;

/// Longer than any operation takes.
const PATIENCE: Duration = Duration::from_secs(60);

/// What an operation comes to when nothing is killed.
struct Whole {
    /// After so many steps.
    states: Vec<State>,
    /// Calls that change something, from its beginning to its end.
    calls: u32,
}

/// Counts calls and lets all of them pass.
const NO_FAULT: Fault = Fault { nth: u32::MAX, calls: Calls::CHANGES, how: How::Once, error: 0 };

impl Whole {
    async fn of(operation: Operation, template: &Template) -> Self {
        let disk = WatchedDisk::new();
        laid_out(template, operation, &disk).await;
        let mut server = disk.start();
        let client = template.client(&server.endpoint()).await;
        let mut prepared = operation.prepare(&client).await;
        let mut states = vec![state(&client).await];
        disk.at_rest().await;
        disk.arm(NO_FAULT);
        for step in 0..operation.steps() {
            let done = operation.step(&client, &mut prepared, step).await;
            assert!(done.is_ok(), "{operation:?}, step {step}: {done:?}");
            states.push(state(&client).await);
        }
        if operation == Operation::Stop {
            drop(client);
            let ended = server.terminate(PATIENCE);
            assert!(ended.is_some_and(|status| status.success()), "{ended:?}: {}", server.log());
        }
        let calls = u32::try_from(disk.counted().0).unwrap();
        let changes = operation.steps() == 0 || states.first() != states.last();
        // A map that is compacted is the same one.
        assert!(
            changes || [Operation::Compact, Operation::Tokens].contains(&operation),
            "{operation:?} changes nothing"
        );
        Self { states, calls }
    }
}

/// What the operation begins with; what is wrong with it.
async fn laid_out(template: &Template, operation: Operation, disk: &WatchedDisk) -> Vec<String> {
    copy_below(template.directory.path(), &disk.data());
    if operation != Operation::Repair {
        return Vec::new();
    }
    rot(&disk.data()).await;
    let wrong = wrong(&disk.data()).await;
    assert!(!wrong.is_empty(), "nothing is damaged");
    wrong
}

/// What a look at all of a directory finds.
async fn wrong(data: &std::path::Path) -> Vec<String> {
    let findings = waypost_server::offline::check_all(data).await.unwrap();
    findings.into_iter().filter_map(|finding| finding.result.err()).collect()
}

/// What came of a kill.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Came {
    /// As before the step that was cut off.
    Before,
    /// As after it, though nobody was told.
    After,
    /// It was over before the call came that was to be the last.
    Over,
    /// A part of it: the map that was to be made, and nothing of its job. It goes on when it is asked for again.
    Part,
}

async fn killed(
    template: &Template,
    operation: Operation,
    whole: &Whole,
    fault: Fault,
) -> Result<Came, String> {
    let disk = WatchedDisk::new();
    let known = laid_out(template, operation, &disk).await;
    let mut server = disk.start();
    let client = template.client(&server.endpoint()).await;
    let mut prepared = operation.prepare(&client).await;
    disk.at_rest().await;
    disk.arm(fault);
    let mut acknowledged = 0;
    let mut said = String::new();
    while acknowledged < operation.steps() as usize && said.is_empty() {
        match operation.step(&client, &mut prepared, acknowledged as u64).await {
            Ok(()) => acknowledged += 1,
            Err(Broken(error)) => said = error,
        }
    }
    if operation == Operation::Stop {
        let _ = server.terminate(PATIENCE);
    } else if said.is_empty() {
        // What goes on after the answer may be cut off, too.
        disk.at_rest().await;
    }
    let met = disk.counted().1 > 0;
    let log = server.log();
    if !met && acknowledged < operation.steps() as usize {
        return Err(format!("step {acknowledged} failed though nothing was killed: {said}\n{log}"));
    }
    server.kill();
    if log.contains("panicked") {
        return Err(log);
    }

    let (mut now, jobs) = template.told(&disk.data()).await;
    let mut came = if met { Came::Before } else { Came::Over };
    if let Some(map) = operation.partial_map().map(|map| format!("maps/{map}")) {
        let own = |name: &String| {
            *name == map || name.starts_with(&format!("{map}/")) || name.starts_with(&format!("{map}:"))
        };
        if now.keys().any(own) && now != whole.states[1] {
            came = Came::Part;
            now.retain(|name, _| !own(name));
        }
    }
    let at = whole.states.iter().rposition(|state| *state == now);
    let first = whole.states.iter().position(|state| *state == now);
    let Some((first, last)) = first.zip(at) else {
        return Err(format!(
            "after {acknowledged} steps: neither before nor after the next one: {}",
            differences(&now, &whole.states)
        ));
    };
    // Of steps that nobody can tell apart, any.
    if last < acknowledged || first > acknowledged + 1 {
        return Err(format!("{acknowledged} steps were acknowledged, and there are {last}"));
    }
    if came == Came::Before && last > acknowledged {
        came = Came::After;
    }
    told_of_jobs(&jobs, (operation, prepared.job.as_deref()), came, whole)?;
    // Also what the server has noted of it since.
    let is_known =
        |found: &String| known.contains(found) || found.contains(&format!("map {OTHER}, session o, frame 8"));
    let whole_before = known.is_empty();
    let unknown = wrong(&disk.data()).await.into_iter().find(|found| whole_before || !is_known(found));
    unknown.map_or(Ok(came), Err)
}

/// Jobs say what became of them: none runs, and one has succeeded whose map is there. One with which another server goes on
/// has succeeded if it was noted at all.
fn told_of_jobs(
    jobs: &BTreeMap<String, job::State>,
    (operation, own): (Operation, Option<&str>),
    came: Came,
    whole: &Whole,
) -> Result<(), String> {
    if let Some((name, _)) = jobs.iter().find(|(_, state)| **state == job::State::Running) {
        return Err(format!("{name} runs after the restart"));
    }
    let Some(state) = own.and_then(|own| jobs.get(own)) else { return Ok(()) };
    let changes = whole.states.first() != whole.states.last();
    let succeeded = *state == job::State::Succeeded;
    if matches!(operation, Operation::Compact | Operation::Rebuild | Operation::Repair) && !succeeded {
        return Err(format!("its job says {state:?}, and the next server was to do it"));
    }
    match came {
        Came::Before | Came::Part if changes && succeeded => {
            Err(format!("its job says {state:?}, and it was cut off"))
        }
        Came::After | Came::Over if changes && !succeeded => {
            Err(format!("its job says {state:?}, and it is done"))
        }
        _ => Ok(()),
    }
}

/// In which things a state is another than each of those that it may be.
fn differences(now: &State, states: &[State]) -> String {
    let differs = |state: &State| {
        let names = now.keys().chain(state.keys()).filter(|name| now.get(*name) != state.get(*name));
        names
            .map(|name| format!("{name}: {:.300?} / {:.300?}", now.get(name), state.get(name)))
            .collect::<Vec<_>>()
            .join("; ")
    };
    states.iter().map(differs).collect::<Vec<_>>().join("\n  or ")
}

#[tokio::test(flavor = "multi_thread")]
async fn whatever_is_cut_off_is_there_whole_or_not_at_all() {
    let tries = Tries::asked("KILLS", KILLS);
    let seed = tries.seed;
    let at_once = std::thread::available_parallelism().map_or(2, usize::from);
    let template = Arc::new(Template::new().await);
    let wholes = futures::stream::iter(OPERATIONS).map(|operation| {
        let template = template.clone();
        on_a_thread(async move || (operation, Whole::of(operation, &template).await))
    });
    let wholes: BTreeMap<Operation, Whole> =
        wholes.buffer_unordered(at_once).map(|whole| whole.unwrap()).collect().await;
    let wholes = Arc::new(wholes);
    let mut counts: BTreeMap<Operation, BTreeMap<Came, u64>> = BTreeMap::new();
    for part in tries.parts() {
        let came = futures::stream::iter(part.clone()).map(|number| {
            let (template, wholes) = (template.clone(), wholes.clone());
            on_a_thread(async move || {
                let mut random = ChaCha8Rng::seed_from_u64(seed);
                random.set_stream(number);
                let operation = OPERATIONS[number as usize % OPERATIONS.len()];
                let whole = &wholes[&operation];
                let how = [How::Kill, How::KillHalfway][random.random_range(0..2)];
                let nth = random.random_range(1..=whole.calls.max(1));
                let fault = Fault { nth, calls: Calls::CHANGES, how, error: 0 };
                let came = killed(&template, operation, whole, fault).await;
                let case = |error| format!("kill {number} of seed {seed}, {operation:?}, {fault:?}: {error}");
                (operation, came.map_err(case))
            })
        });
        let came: Vec<_> = came.buffer_unordered(at_once).map(|came| came.unwrap()).collect().await;
        let mut wrong = Vec::new();
        for (operation, came) in came {
            match came {
                Ok(came) => *counts.entry(operation).or_default().entry(came).or_default() += 1,
                Err(case) => wrong.push(case),
            }
        }
        tries.told(&part, format_args!("{} are wrong", wrong.len()));
        assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    }
    for (operation, counts) in &counts {
        println!("{operation:?}, {} calls: {counts:?}", wholes[operation].calls);
    }
    let kills = tries.count();
    let met = counts
        .values()
        .flatten()
        .filter(|(came, _)| **came != Came::Over)
        .map(|(_, count)| count)
        .sum::<u64>();
    assert!(met * 4 > kills * 3, "{met} of {kills} kills met a call");
}
