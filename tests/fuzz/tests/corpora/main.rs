//! Every file of the corpora, and mutations of them, fed to the targets: the fuzzing that needs no fuzzer.
#![allow(clippy::unwrap_used, clippy::expect_used, reason = "a test fails by panicking")]

mod seeds;

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, Once};
use std::time::{Duration, Instant};

use waypost_fuzz::mutation::Mutations;
use waypost_fuzz::{Fed, TARGETS, Target, corpus, memory, named};

#[global_allocator]
static ALLOCATOR: memory::Counting = memory::Counting;

/// Mutations of each corpus; `WAYPOST_FUZZ_MUTATIONS=100000 WAYPOST_FUZZ_SEED=2` makes more, and others.
const MUTATIONS: u64 = 2000;

/// What one input may take. An image of the largest size, decoded in colour of 16 bits, takes about half.
const MOST_BYTES: usize = 256 << 20;
const LONGEST: Duration = Duration::from_secs(1);

/// All corpora together: they are for what no generator makes, not for what a fuzzer finds by itself.
const MOST_CORPUS_BYTES: usize = 300_000;

/// Memory is counted for all threads: one test at a time.
static ALONE: Mutex<()> = Mutex::new(());

/// Panics so far, on all threads: some of what is fed is worked on elsewhere.
static PANICS: AtomicUsize = AtomicUsize::new(0);
static COUNTED: Once = Once::new();

fn count_panics() {
    COUNTED.call_once(|| {
        let told = std::panic::take_hook();
        std::panic::set_hook(Box::new(move |panic| {
            PANICS.fetch_add(1, Ordering::Relaxed);
            told(panic);
        }));
    });
}

fn setting(name: &str, usual: u64) -> u64 {
    std::env::var(name).map_or(usual, |value| value.parse().expect("a number"))
}

/// Feeds bytes that no target may choke on; what is wrong if one does.
fn feed(target: &Target, bytes: &[u8]) -> Result<Fed, String> {
    count_panics();
    let panics = PANICS.load(Ordering::Relaxed);
    let once = || {
        let began = Instant::now();
        let (fed, peak) = memory::peak_of(|| catch_unwind(AssertUnwindSafe(|| (target.feed)(bytes))));
        (fed, peak, began.elapsed())
    };
    let (fed, peak, mut took) = once();
    let fed = fed.map_err(|_| "it panicked".to_owned())?;
    if PANICS.load(Ordering::Relaxed) > panics {
        return Err("it panicked, on another thread".to_owned());
    }
    if peak > MOST_BYTES {
        return Err(format!("it took {peak} bytes of memory"));
    }
    // The machine may be busy with other things.
    for _ in 0..4 {
        if took > LONGEST {
            took = took.min(once().2);
        }
    }
    if took > LONGEST { Err(format!("it took {took:?}")) } else { Ok(fed) }
}

/// Where an input is kept that was too much, for who wants to look at it.
fn keep(target: &Target, bytes: &[u8]) -> String {
    let path = std::env::temp_dir().join(format!("waypost-fuzz-{}", target.name));
    std::fs::write(&path, bytes).unwrap();
    path.display().to_string()
}

#[test]
fn what_is_kept_does_no_harm() {
    let _alone = ALONE.lock();
    let mut bytes = 0;
    for target in TARGETS {
        let mut taken = 0;
        for (name, file) in corpus::files(target) {
            bytes += file.len();
            match feed(target, &file) {
                Ok(Fed::Taken) => taken += 1,
                Ok(Fed::Refused) => {
                    assert!(!name.starts_with("taken"), "{}/{name} was refused", target.name);
                }
                Err(wrong) => panic!("{}/{name}: {wrong}", target.name),
            }
        }
        assert!(taken > 0, "{} takes nothing of its corpus, so it tests little", target.name);
    }
    assert!(bytes < MOST_CORPUS_BYTES, "the corpora have {bytes} bytes");
}

#[test]
fn nearly_what_is_kept_does_no_harm() {
    let _alone = ALONE.lock();
    let (mutations, seed) = (setting("WAYPOST_FUZZ_MUTATIONS", MUTATIONS), setting("WAYPOST_FUZZ_SEED", 1));
    for target in TARGETS {
        let corpus: Vec<Vec<u8>> = corpus::files(target).into_iter().map(|(_, file)| file).collect();
        let mut mutated = Mutations::of(&corpus, seed);
        let (began, mut taken) = (Instant::now(), 0);
        for number in 0..mutations {
            let bytes = mutated.one();
            match feed(target, &bytes) {
                Ok(fed) => taken += u64::from(fed == Fed::Taken),
                Err(wrong) => panic!("{}, mutation {number}: {wrong}; {}", target.name, keep(target, &bytes)),
            }
        }
        println!("{:15} {mutations} mutations, {taken} taken, {:.1?}", target.name, began.elapsed());
        assert!((1..mutations).contains(&taken), "{} took {taken} of {mutations}", target.name);
    }
}

#[test]
fn every_target_has_a_corpus_and_every_corpus_a_target() {
    for entry in std::fs::read_dir(corpus::directory()).unwrap() {
        let name = entry.unwrap().file_name().into_string().unwrap();
        assert!(named(&name).is_some(), "corpus/{name} is of no target");
    }
    for target in TARGETS {
        assert!(!corpus::files(target).is_empty(), "{}", target.name);
    }
}

#[test]
fn the_same_seed_makes_the_same_mutations() {
    let corpus = [b"one".to_vec(), b"two and three".to_vec()];
    let made = |seed| {
        let mut mutations = Mutations::of(&corpus, seed);
        (0..100).map(|_| mutations.one()).collect::<Vec<_>>()
    };
    assert_eq!(made(1), made(1));
    assert_ne!(made(1), made(2));
}

/// Shows that a target that panics, takes memory or takes time is told from one that does not.
#[test]
fn harm_is_noticed() {
    let _alone = ALONE.lock();
    fn harmful(bytes: &[u8]) -> Fed {
        match bytes {
            b"panic" => panic!("as it should"),
            b"thread" => drop(std::thread::spawn(|| panic!("as it should")).join()),
            b"memory" => drop(std::hint::black_box(vec![1_u8; MOST_BYTES + 1])),
            b"time" => std::thread::sleep(LONGEST + LONGEST / 10),
            _ => return Fed::Refused,
        }
        Fed::Taken
    }
    let target = Target { name: "harmful", feed: harmful };
    assert_eq!(feed(&target, b"nothing"), Ok(Fed::Refused));
    let harms = [
        (&b"panic"[..], "it panicked"),
        (b"thread", "on another thread"),
        (b"memory", "bytes of memory"),
        (b"time", "it took"),
    ];
    for (bytes, wrong) in harms {
        let told = feed(&target, bytes).unwrap_err();
        assert!(told.contains(wrong), "{told}");
    }
}
