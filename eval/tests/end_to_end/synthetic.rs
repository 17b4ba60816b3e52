//! A drive twice round a small made-up world: every stage runs, and the loops must be found.

use std::fs;
use std::path::{Path, PathBuf};

use image::{GrayImage, Luma};
use serde_json::Value;

use crate::tool::{Row, candidate_rows, frame_rows, proposal, waypost_eval, waypost_eval_on_threads};

pub(crate) const PLACES: usize = 8;
pub(crate) const GAP: usize = 4;
const SIDE_PX: u32 = 240;

/// Two passes over eight places, the second two pixels to the right; a model trained on other
/// places of the same world.
pub(crate) struct World {
    pub(crate) folder: tempfile::TempDir,
}

impl World {
    pub(crate) fn new() -> Self {
        let world = Self { folder: tempfile::tempdir().unwrap() };
        for place in 0..30 {
            save(&texture(1000 + place, 0), &world.path("training").join(format!("{place:03}.png")));
        }
        for pass in 0..2 {
            for place in 0..PLACES {
                let index = pass * PLACES + place;
                let image = texture(place as u64, 2 * pass as u32);
                save(&image, &world.sequence().join(format!("images/{index:06}.png")));
            }
        }
        let loops: String = (0..PLACES).map(|place| format!("{},{place}\n", PLACES + place)).collect();
        fs::write(world.sequence().join("loops.csv"), format!("query_index,match_index\n{loops}")).unwrap();
        world
    }

    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    pub(crate) fn sequence(&self) -> PathBuf {
        self.path("sequence")
    }

    pub(crate) fn text(&self, name: &str) -> String {
        self.path(name).display().to_string()
    }

    /// Trains with `--json`; the model is at `path(out)`.
    pub(crate) fn train(&self, out: &str) -> Value {
        self.train_on_threads(2, out)
    }

    fn train_on_threads(&self, threads: usize, out: &str) -> Value {
        let (images, out) = (self.text("training"), self.text(out));
        let settings = ["--feature", "orb", "--words", "200", "--seed", "3", "--json"];
        let arguments = ["train", "--images", &images, "--out", &out];
        waypost_eval_on_threads(threads, &[&arguments[..], &settings].concat()).json()
    }

    /// Trains on a walk of which every second image overlaps the one before; the model is at `path(out)`.
    pub(crate) fn train_on_walk(&self, out: &str) {
        for index in 0..140 {
            let image = texture(2000 + index / 2, 4 * (index % 2) as u32);
            save(&image, &self.path("walk").join(format!("{index:03}.png")));
        }
        let (images, out) = (self.text("walk"), self.text(out));
        let settings = ["--feature", "orb", "--words", "200", "--seed", "3", "--json"];
        let arguments = ["train", "--images", &images, "--out", &out];
        waypost_eval(&[&arguments[..], &settings].concat()).json();
    }

    /// Runs the sequence with `--json` and more arguments; results are at `path(out)`.
    pub(crate) fn run(&self, model: &str, out: &str, more: &[&str]) -> Value {
        let (sequence, model, out) = (self.text("sequence"), self.text(model), self.text(out));
        let gap = GAP.to_string();
        let mut arguments = vec![
            "sequence",
            "--sequence",
            &sequence,
            "--gap",
            &gap,
            "--model",
            &model,
            "--out",
            &out,
            "--json",
        ];
        arguments.extend(more);
        waypost_eval(&arguments).json()
    }
}

/// Grey blocks of different sizes, all a function of the seed; shifted to the left by `shift_px`.
fn texture(seed: u64, shift_px: u32) -> GrayImage {
    let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
    let mut next = move |below: u32| {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        ((state >> 33) % u64::from(below)) as u32
    };
    let mut wide = GrayImage::from_pixel(SIDE_PX + 16, SIDE_PX, Luma([128]));
    for _ in 0..150 {
        let (x, y) = (next(SIDE_PX + 16), next(SIDE_PX));
        let (width, height) = (6 + next(30), 6 + next(30));
        let grey = Luma([next(256) as u8]);
        for row in y..(y + height).min(wide.height()) {
            for column in x..(x + width).min(wide.width()) {
                wide.put_pixel(column, row, grey);
            }
        }
    }
    GrayImage::from_fn(SIDE_PX, SIDE_PX, |x, y| *wide.get_pixel(x + shift_px, y))
}

fn save(image: &GrayImage, path: &Path) {
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    image.save(path).unwrap();
}

#[test]
fn a_second_pass_is_recognised() {
    let world = World::new();
    let trained = world.train("model");
    assert_eq!((&trained["images"], &trained["words"]), (&Value::from(30), &Value::from(200)));
    assert_eq!(trained["bytes"], Value::from(fs::metadata(world.path("model")).unwrap().len()));
    assert!(trained["seconds"]["extract"].is_f64() && trained["seconds"]["train"].is_f64());

    let report = world.run("model", "out", &[]);
    assert_eq!(report["frames"], 16);
    assert_eq!(report["queries_with_loop"], 8);
    assert!(report["recall_at_100_precision"].as_f64().unwrap() > 0.8, "{report}");
    assert!(report["average_precision"].as_f64().unwrap() > 0.8, "{report}");
    for stage in ["extract", "quantize", "likelihood", "new_place", "filter", "verify", "total"] {
        assert!(report["ms_p50"][stage].as_f64().unwrap() >= 0.0, "{stage}");
    }
    let unverified = world.run("model", "unverified", &["--verify", "none"]);
    assert_eq!(unverified["ms_p50"].get("verify"), Some(&Value::Null));

    for name in ["precision_recall.csv", "precision_recall.svg", "match_matrix.png"] {
        assert!(fs::metadata(world.path("out").join(name)).unwrap().len() > 0, "{name}");
    }
    let pictures = fs::read_dir(world.path("out/mistakes")).unwrap().count() as u64;
    assert_eq!(pictures, report["false_positives"].as_u64().unwrap().min(5), "{report}");
    let summary: Value = serde_json::from_slice(&fs::read(world.path("out/summary.json")).unwrap()).unwrap();
    assert_eq!(summary["average_precision"], report["average_precision"]);
    assert_eq!(summary["model_hash"], trained["model_hash"]);
    assert_rows_agree(&frame_rows(&world.path("out")), &report);
    assert_candidates_agree(&candidate_rows(&world.path("out")), &frame_rows(&world.path("out")));
}

/// What was proposed was compared, with the same numbers.
fn assert_candidates_agree(candidates: &[Row], frames: &[Row]) {
    for (index, frame) in frames.iter().enumerate() {
        let of_frame: Vec<&Row> = candidates.iter().filter(|row| row["index"] == index.to_string()).collect();
        assert!(of_frame.len() <= 8, "{of_frame:?}");
        assert_eq!(of_frame.is_empty(), proposal(frame).is_none());
        if let Some(earlier) = proposal(frame) {
            let proposed = of_frame.iter().find(|row| row["frame"] == earlier.to_string()).unwrap();
            assert_eq!(proposed["probability"], frame["proposal_probability"]);
            assert_eq!(proposed["posterior"], frame["proposal_posterior"]);
            assert_eq!(proposed["verdict"], frame["verdict"]);
            let number = |column: &str| proposed[column].parse::<f64>().unwrap();
            assert!(
                number("inliers") <= number("matches") && number("distinct_inliers") <= number("inliers")
            );
            assert!(
                number("own_evidence_inliers") <= number("evidence_inliers")
                    || number("own_evidence_inliers") < 20.0
            );
        }
    }
}

/// The table of frames and the report tell the same story, and the gap is kept.
fn assert_rows_agree(rows: &[Row], report: &Value) {
    assert_eq!(rows.len(), 16);
    for (index, row) in rows.iter().enumerate() {
        assert_eq!(row["index"], index.to_string());
        assert_eq!(row["image"], format!("{index:06}.png"));
        if let Some(earlier) = proposal(row) {
            assert!(earlier + GAP <= index);
            let is_loop = index >= PLACES && earlier + PLACES == index;
            assert_eq!(row["verdict"], is_loop.to_string());
        }
    }
    let count = |column: &str, value: &str| rows.iter().filter(|row| row[column] == value).count();
    assert_eq!(report["true_positives"], count("verdict", "true"));
    assert_eq!(report["false_positives"], count("verdict", "false"));
    assert_eq!(report["loop_closures"], count("reason", "loop-closure"));
    // Every closure is right here, and leads to a place that was known.
    let (recognised, closures) =
        (report["recognised"].as_u64().unwrap(), report["loop_closures"].as_u64().unwrap());
    assert!(recognised >= closures && recognised <= 8 && closures > 0, "{report}");
    assert_eq!(
        (&report["loop_closures_false"], &report["recognised_wrongly"]),
        (&Value::from(0), &Value::from(0))
    );
}

#[test]
fn index_and_dense_scorer_decide_alike() {
    let world = World::new();
    world.train("model");
    for variant in
        [["--dependence", "chow_liu"], ["--new-place", "mean_field"], ["--dependence", "naive_bayes"]]
    {
        let decisions = ["index", "dense"].map(|scorer| {
            world.run("model", scorer, &[&["--scorer", scorer], &variant[..]].concat());
            let rows = frame_rows(&world.path(scorer)).into_iter();
            let columns = ["reason", "place", "proposal_frame", "verdict", "closure_frame"];
            rows.map(|row| columns.map(|column| row[column].clone())).collect::<Vec<_>>()
        });
        assert_eq!(decisions[0], decisions[1], "{variant:?}");
        assert!(decisions[0].iter().any(|[reason, ..]| reason != "new-place"), "{variant:?}");
    }
}

#[test]
fn the_baseline_ranks_by_similarity_alone() {
    let world = World::new();
    world.train("model");
    let report = world.run("model", "out", &["--ranking", "tf-idf"]);
    assert!(report["recall_at_100_precision"].as_f64().unwrap() > 0.8, "{report}");
    for key in ["places", "loop_closures", "loop_closures_false", "recognised", "recognised_wrongly"] {
        assert_eq!(report.get(key), Some(&Value::Null), "{key}");
    }
    assert!(candidate_rows(&world.path("out")).is_empty());
    for (index, row) in frame_rows(&world.path("out")).iter().enumerate() {
        assert_eq!(proposal(row).is_some(), index >= GAP);
        assert!(proposal(row).is_none_or(|earlier| earlier + GAP <= index));
    }
    let accepting = world.run("model", "out", &["--ranking", "tf-idf", "--threshold", "0.0"]);
    assert_eq!(accepting["loop_closures"], 16 - GAP);
}

#[test]
fn the_same_seed_trains_the_same_model_on_any_number_of_threads() {
    let world = World::new();
    let first = world.train_on_threads(1, "first");
    let again = world.train_on_threads(5, "again");
    assert_eq!(first["model_hash"], again["model_hash"]);
    assert_eq!(fs::read(world.path("first")).unwrap(), fs::read(world.path("again")).unwrap());
}

#[test]
fn without_json_stdout_stays_empty_and_people_get_the_figures() {
    let world = World::new();
    world.train("model");
    let (sequence, model, out) = (world.text("sequence"), world.text("model"), world.text("out"));
    let run =
        waypost_eval(&["sequence", "--sequence", &sequence, "--gap", "4", "--model", &model, "--out", &out]);
    assert_eq!((run.exit_code, run.stdout.as_str()), (Some(0), ""));
    assert!(run.stderr.contains("recall_at_100_precision"), "{}", run.stderr);
}

/// One level of twenty words of 32 bytes, as DBoW2 writes them.
fn orb_text() -> String {
    let word = |word: u32| {
        let bytes: Vec<String> =
            (0..32).map(|byte| ((word * 37 + byte * 101 + word * byte) % 256).to_string()).collect();
        format!("0 1 {} 0.5\n", bytes.join(" "))
    };
    "20 1 0 0\n".to_owned() + &(0..20).map(word).collect::<String>()
}

#[test]
fn words_can_come_from_an_orb_vocabulary() {
    let world = World::new();
    std::fs::write(world.path("orb.txt"), orb_text()).unwrap();
    let (images, text, out) = (world.text("sequence"), world.text("orb.txt"), world.text("orb.waypost"));
    let train = ["train", "--images", &images, "--orb-vocabulary", &text, "--out", &out, "--json"];
    let refusal = waypost_eval(&train);
    assert!(refusal.refusal(2).contains("--feature orb"));
    let trained = waypost_eval(&[&train[..], &["--feature", "orb"]].concat()).json();
    assert_eq!(trained["words"], 20);
    let report = world.run("orb.waypost", "orb", &[]);
    assert_eq!(report["frames"], 2 * PLACES);
    assert!(report["places"].as_u64().unwrap() >= 1);
}
