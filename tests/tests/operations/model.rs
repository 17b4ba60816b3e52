//! Robots and people at random, against a model: a server that is killed and started again between and in the middle of
//! their calls answers as a plain one in memory does, and holds what that holds.
//!
//! `operations` draws the steps, `plain` is what the server is to be, `calls` makes a step to both, `runner` goes from one
//! step to the next and kills, `comparison` has all that is told, `replay` streams into a fresh server, `shrinking` leaves out
//! of a list that fails what it does not need. `sabotage` shows that this bites.
//!
//! `WAYPOST_MODEL_STEPS` is how many steps there are, a run of [`STEPS_OF_A_RUN`] for each seed from
//! `WAYPOST_MODEL_SEED` on. Runs are told one by one: whoever stopped goes on with the seed that is told, and adds up.

mod calls;
mod comparison;
mod operations;
mod plain;
mod replay;
mod runner;
mod sabotage;
mod seen;
mod serving;
mod shrinking;
mod together;

use std::time::{Duration, Instant};

use futures::StreamExt;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use super::disk::on_a_thread;
use super::long_runs::number;
use operations::{Step, steps};
use runner::{Counts, Runner};
use sabotage::Sabotage;

/// Steps in every run of the tests.
const STEPS: u64 = 600;

/// Steps of one seed, on a server of its own.
const STEPS_OF_A_RUN: u64 = 300;

/// How long a list of steps that fails is made shorter.
const SHRINKING: Duration = Duration::from_secs(60);

/// The same for those of a server that is known to be wrong.
const SHRINKING_OF_SABOTAGE: Duration = Duration::from_secs(8);

/// Lists of so many steps, of which one finds what a server is made to get wrong.
const STEPS_OF_SABOTAGE: u64 = 180;
const SEEDS_OF_SABOTAGE: u64 = 6;

/// What a run came to.
#[derive(Debug)]
enum Came {
    Whole(Counts),
    Failed(Failure),
}

/// What the server and the model do not agree in.
#[derive(Clone, Debug)]
struct Failure {
    /// At which step.
    at: usize,
    why: String,
    /// Steps before that changed nothing.
    idle: Vec<usize>,
}

/// Runs a list of steps from nothing.
async fn run(seed: u64, steps: Vec<Step>, sabotage: Option<Sabotage>) -> Came {
    let running = on_a_thread(async move || {
        let mut runner = Runner::new(seed, sabotage).await;
        let mut idle = Vec::new();
        for (at, step) in steps.iter().enumerate() {
            if let Err(why) = runner.step(step).await {
                return Came::Failed(Failure { at, why, idle });
            }
            idle.extend(runner.idle.then_some(at));
        }
        let ended = async {
            runner.finish().await?;
            replay::replayed(&runner.world).await
        };
        match ended.await {
            Ok(frames) => {
                runner.counts.insert("frames streamed again".to_owned(), frames);
                Came::Whole(runner.counts)
            }
            Err(why) => Came::Failed(Failure { at: steps.len(), why, idle }),
        }
    });
    // Whatever panics has not passed.
    running.await.unwrap_or_else(|panicked| {
        Came::Failed(Failure { at: usize::MAX - 1, why: panicked.to_string(), idle: Vec::new() })
    })
}

/// The fewest steps found that fail still, and why they do.
async fn shrunk(
    seed: u64,
    mut list: Vec<Step>,
    sabotage: Option<Sabotage>,
    Failure { at, why, idle }: Failure,
) -> (Vec<Step>, String) {
    list.truncate(at + 1);
    let fails = |steps| async move {
        match run(seed, steps, sabotage).await {
            Came::Whole(_) => None,
            Came::Failed(Failure { why, .. }) => Some(why),
        }
    };
    // What changed nothing is most likely not needed.
    let busy = list.iter().enumerate().filter(|(index, _)| !idle.contains(index));
    let busy: Vec<Step> = busy.map(|(_, step)| step.clone()).collect();
    let (list, why) = match fails(busy.clone()).await {
        Some(still) => (busy, still),
        None => (list, why),
    };
    let within = if sabotage.is_some() { SHRINKING_OF_SABOTAGE } else { SHRINKING };
    let within = Duration::from_secs(number("WAYPOST_MODEL_SHRINKING_S", within.as_secs()));
    shrinking::shrunk(list, why, within, fails).await
}

fn now_ns() -> i64 {
    let now = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap();
    i64::try_from(now.as_nanos()).unwrap()
}

fn drawn(seed: u64, count: u64) -> Vec<Step> {
    steps(&mut ChaCha8Rng::seed_from_u64(seed), count)
}

fn told(steps: &[Step]) -> String {
    steps.iter().map(|step| format!("    {step:?}")).collect::<Vec<_>>().join("\n")
}

#[tokio::test(flavor = "multi_thread")]
async fn whatever_is_done_the_server_is_what_the_model_is() {
    let (count, first) = (number("WAYPOST_MODEL_STEPS", STEPS), number("WAYPOST_MODEL_SEED", 1));
    let at_once = std::thread::available_parallelism().map_or(2, usize::from);
    let runs = (0..count.div_ceil(STEPS_OF_A_RUN))
        .map(|run| (first + run, STEPS_OF_A_RUN.min(count - run * STEPS_OF_A_RUN)));
    let mut came = futures::stream::iter(runs)
        .map(|(seed, count)| async move {
            let began = Instant::now();
            (seed, count, run(seed, drawn(seed, count), None).await, began.elapsed())
        })
        .buffer_unordered(at_once);
    let mut counts = Counts::new();
    let mut failed = None;
    while let Some((seed, count, came, took)) = came.next().await {
        match came {
            Came::Whole(of_run) => {
                println!("seed {seed}: {count} steps in {:.1} s", took.as_secs_f64());
                of_run.into_iter().for_each(|(what, many)| *counts.entry(what).or_default() += many);
            }
            Came::Failed(failure) => {
                failed = Some((seed, count, failure));
                break;
            }
        }
    }
    drop(came);
    for (what, many) in &counts {
        println!("{many:8} {what}");
    }
    if let Some((seed, count, failure)) = failed {
        let Failure { at, why, .. } = failure.clone();
        let (fewer, still) = shrunk(seed, drawn(seed, count), None, failure).await;
        panic!(
            "seed {seed}, step {at}: {why}\nrepeat by WAYPOST_MODEL_SEED={seed} WAYPOST_MODEL_STEPS={count}; \
             of its steps these fail still, with {still}\n{}",
            told(&fewer)
        );
    }
}

/// A server that forgets something at a restart, or lets in who may not, is found out by few steps.
#[tokio::test(flavor = "multi_thread")]
async fn the_model_finds_what_a_server_gets_wrong() {
    for sabotage in Sabotage::ALL {
        // Not every list has what would be forgotten.
        let mut found = None;
        for seed in 1..=SEEDS_OF_SABOTAGE {
            let list = drawn(seed, STEPS_OF_SABOTAGE);
            if let Came::Failed(failure) = run(seed, list.clone(), Some(sabotage)).await {
                found = Some((seed, list, failure));
                break;
            }
        }
        let Some((seed, list, failure)) = found else { panic!("{sabotage:?} was not found") };
        let at = failure.at;
        let (fewer, still) = shrunk(seed, list, Some(sabotage), failure).await;
        let steps = fewer.len();
        println!(
            "{sabotage:?}, found at step {at} of seed {seed}, by {steps} steps:\n{}\n  {still}",
            told(&fewer)
        );
        assert!(steps * 2 <= at.max(16), "{sabotage:?}: {steps} steps are left of {at}");
    }
}
