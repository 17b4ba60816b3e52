//! `waypost inspect`: what is in a bag, and what a stream of it would use; what is in a database of RTAB-Map.

mod rtabmap;

use std::io::{self, Write};
use std::path::PathBuf;

use serde::Serialize;
use waypost_bags::rtabmap::RtabMap;
use waypost_bags::{Bag, Choice, Topic};

use crate::drive::{Topics, cut_off, open_bag, problems, used};
use crate::failure::{EXIT_CODES, Failure};
use crate::output::{Output, table};

/// Show the topics of a robot's bag, and which of them `waypost stream` would use, or what is in a
/// database of RTAB-Map
///
/// Reads all of an MCAP file, a database of rosbag2 (.db3) or its folder, or a ROS 1 bag, with its
/// checksums; or a database of RTAB-Map (.db), which `waypost import` takes. No server is needed.
/// It fails where a stream would refuse the bag, after it has shown what is in it.
#[derive(clap::Args)]
#[command(after_help = EXIT_CODES)]
pub(crate) struct Arguments {
    /// The bag, or the database
    bag: PathBuf,
    #[command(flatten)]
    topics: Topics,
}

/// What `--json` prints.
#[derive(Serialize)]
struct Inspected {
    bag: String,
    topics: Vec<TopicRow>,
    /// What a stream would use; null if it could not.
    stream: Option<Used>,
    /// Why nothing can be streamed; null if it can.
    stream_refused: Option<String>,
    /// What is damaged, left out or not there, a sentence each.
    problems: Vec<String>,
}

#[derive(Serialize)]
struct TopicRow {
    name: String,
    r#type: String,
    messages: u64,
    rate_hz: Option<f64>,
    /// By the headers, or else by the recording.
    first_ns: i64,
    last_ns: i64,
    /// Of images: jpeg, png or the encoding of raw pixels.
    form: Option<String>,
    width_px: Option<u32>,
    height_px: Option<u32>,
    unreadable: u64,
    /// What is wrong with the first message that cannot be read.
    first_problem: Option<String>,
}

#[derive(Serialize)]
struct Used {
    frames: usize,
    image_topic: String,
    odometry_topic: Option<String>,
    camera_info_topic: Option<String>,
}

pub(crate) async fn run(arguments: Arguments, output: Output) -> Result<(), Failure> {
    let Arguments { bag, topics } = arguments;
    if RtabMap::is_database(&bag) {
        return match topics.first_flag() {
            None => rtabmap::run(&bag, output).await,
            Some(flag) => {
                let bag = bag.display();
                Err(Failure::Unfit(format!("{flag} is for bags, and {bag} is none; leave it out")))
            }
        };
    }
    let path = bag;
    let bag = open_bag(&path, output).await?;
    let choice = bag.choose(&topics.wanted());
    let told = match &choice {
        Ok(choice) => problems(&bag, choice),
        Err(_) => cut_off(&bag),
    };
    let inspected = Inspected {
        bag: bag.path().display().to_string(),
        topics: bag.topics().iter().map(TopicRow::of).collect(),
        stream: choice.as_ref().ok().map(Used::of),
        stream_refused: choice.as_ref().err().map(ToString::to_string),
        problems: told,
    };
    output.result(&inspected, |out| write(&inspected, &bag, choice.as_ref().ok(), out))?;
    choice.map(|_| ()).map_err(|source| Failure::Topics { path, source })
}

fn write(inspected: &Inspected, bag: &Bag, choice: Option<&Choice>, out: &mut dyn Write) -> io::Result<()> {
    let headings = ["TOPIC", "TYPE", "MESSAGES", "HZ", "FROM", "TO", "IMAGES"];
    table(out, headings, inspected.topics.iter().map(TopicRow::cells))?;
    for topic in bag.topics() {
        if let Some(left_out) = &topic.left_out {
            let waypost_bags::LeftOut { count, first_number, first_log_ns, first_problem } = left_out;
            let name = &topic.name;
            writeln!(
                out,
                "{name}: {count} messages cannot be read; the first is number {first_number}, recorded at {first_log_ns} ns: {first_problem}"
            )?;
        }
    }
    writeln!(out)?;
    match (choice, &inspected.stream_refused) {
        (Some(choice), _) => {
            writeln!(out, "waypost stream uses")?;
            for line in used(choice) {
                writeln!(out, "  {line}")?;
            }
        }
        (None, refused) => {
            writeln!(out, "waypost stream refuses it: {}", refused.as_deref().unwrap_or_default())?;
        }
    }
    for problem in &inspected.problems {
        writeln!(out, "note: {problem}")?;
    }
    Ok(())
}

impl Used {
    fn of(choice: &Choice) -> Self {
        Self {
            frames: choice.frame_count(),
            image_topic: choice.image_topic.clone(),
            odometry_topic: choice.odometry.as_ref().map(|odometry| odometry.topic.clone()),
            camera_info_topic: choice.camera_info_topic.clone(),
        }
    }
}

impl TopicRow {
    fn of(topic: &Topic) -> Self {
        let (first_ns, last_ns) = topic.stamped_ns.unwrap_or(topic.recorded_ns);
        Self {
            name: topic.name.clone(),
            r#type: topic.type_name.clone(),
            messages: topic.count,
            rate_hz: topic.rate_hz(),
            first_ns,
            last_ns,
            form: topic.form.clone(),
            width_px: topic.size_px.map(|(width, _)| width),
            height_px: topic.size_px.map(|(_, height)| height),
            unreadable: topic.count - topic.readable(),
            first_problem: topic.left_out.as_ref().map(|left_out| left_out.first_problem.to_string()),
        }
    }

    fn cells(&self) -> [String; 7] {
        let size = match (self.width_px, self.height_px) {
            (Some(width), Some(height)) => format!(" {width} x {height}"),
            (_, _) => String::new(),
        };
        [
            self.name.clone(),
            self.r#type.clone(),
            self.messages.to_string(),
            self.rate_hz.map_or_else(String::new, |rate_hz| format!("{rate_hz:.1}")),
            seconds(self.first_ns),
            seconds(self.last_ns),
            self.form.as_ref().map_or_else(String::new, |form| format!("{form}{size}")),
        ]
    }
}

fn seconds(stamp_ns: i64) -> String {
    format!("{:.3}", stamp_ns as f64 / 1e9)
}
