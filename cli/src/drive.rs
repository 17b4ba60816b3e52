//! A robot's bag as what is streamed.

use std::io::Write;
use std::ops::ControlFlow;
use std::path::Path;
use std::sync::Arc;

use clap::ValueEnum;
use tokio::sync::mpsc::{Receiver, channel};
use tokio::task::JoinHandle;
use waypost_bags::{Bag, BagError, Camera, Choice, Clock, Joined, Lens, Pose, Rectification, Wanted};
use waypost_client::v1::{self, Odometry};

use crate::failure::Failure;
use crate::moments::without_odometry;
use crate::odometry::{message, pose_message};
use crate::output::Output;
use crate::progress;

/// Images that are read ahead.
const MOST_AHEAD: usize = 4;

/// Which topics of a bag are used.
#[derive(clap::Args, Clone)]
#[command(next_help_heading = "Options for bags")]
pub(crate) struct Topics {
    /// Topic of the images, where several have some
    #[arg(long, value_name = "TOPIC")]
    image_topic: Option<String>,
    /// Topic of the camera's CameraInfo, or `none`; if left out, the one beside the images
    #[arg(long, value_name = "TOPIC")]
    camera_info_topic: Option<String>,
    /// Topic of odometry (Odometry, PoseStamped, or TFMessage with odom to base_link or
    /// base_footprint), or `none`; if left out, the only one of type nav_msgs/Odometry
    #[arg(long, value_name = "TOPIC")]
    odometry_topic: Option<String>,
    /// Which times count: those in the messages' headers, which is the default, or those of recording
    #[arg(long, value_enum, value_name = "CLOCK")]
    stamps: Option<StampsOf>,
    /// What the images are, whatever their topic is called; if left out, those of image_rect… topics
    /// are rectified
    #[arg(long, value_enum, value_name = "IMAGES")]
    rectification: Option<ImagesAre>,
}

/// What the images are.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum ImagesAre {
    /// As the camera took them
    Raw,
    /// Without distortion, by the CameraInfo's projection
    Rectified,
}

/// Which times count.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum StampsOf {
    /// Of the messages' headers
    Header,
    /// Of recording
    Log,
}

impl Topics {
    /// A flag that was given.
    pub(crate) fn first_flag(&self) -> Option<&'static str> {
        let Topics { image_topic, camera_info_topic, odometry_topic, stamps, rectification } = self;
        let flags = [
            ("--image-topic", image_topic.is_some()),
            ("--camera-info-topic", camera_info_topic.is_some()),
            ("--odometry-topic", odometry_topic.is_some()),
            ("--stamps", stamps.is_some()),
            ("--rectification", rectification.is_some()),
        ];
        flags.into_iter().find_map(|(flag, is_given)| is_given.then_some(flag))
    }

    pub(crate) fn wanted(self) -> Wanted {
        let Topics { image_topic, camera_info_topic, odometry_topic, stamps, rectification } = self;
        let clock = match stamps {
            None | Some(StampsOf::Header) => Clock::Header,
            Some(StampsOf::Log) => Clock::Log,
        };
        let rectification = rectification.map(|images| match images {
            ImagesAre::Raw => Rectification::Raw,
            ImagesAre::Rectified => Rectification::Rectified,
        });
        Wanted { image_topic, camera_info_topic, odometry_topic, clock, rectification }
    }
}

/// An image with all that a frame needs.
pub(crate) struct Shot {
    pub(crate) sequence: u64,
    pub(crate) stamp_ns: i64,
    pub(crate) image: Vec<u8>,
    pub(crate) odometry: Option<Odometry>,
    /// What it is called in its recording.
    pub(crate) note: String,
}

/// A bag, and which of its topics are streamed.
pub(crate) struct Drive {
    bag: Bag,
    choice: Choice,
}

/// Reads a bag to its end, away from the asynchronous threads.
pub(crate) async fn open_bag(path: &Path, output: Output) -> Result<Bag, Failure> {
    let bar = progress::bytes(output, "reading the bag", 0);
    let path = path.to_owned();
    let reading = tokio::task::spawn_blocking(move || {
        let bag = Bag::open(&path, &mut |done, all| {
            bar.set_length(all);
            bar.set_position(done);
        });
        bar.finish_and_clear();
        bag
    });
    Ok(joined(reading).await?)
}

async fn joined<T>(reading: JoinHandle<Result<T, BagError>>) -> Result<T, BagError> {
    reading.await.unwrap_or_else(|panic| std::panic::resume_unwind(panic.into_panic()))
}

impl Drive {
    pub(crate) async fn open(path: &Path, topics: Topics, output: Output) -> Result<Self, Failure> {
        let bag = open_bag(path, output).await?;
        let choice = bag
            .choose(&topics.wanted())
            .map_err(|source| Failure::Topics { path: path.to_owned(), source })?;
        Ok(Self { bag, choice })
    }

    /// Says on stderr what is used, and what is not.
    pub(crate) fn tell(&self) {
        let mut lines = used(&self.choice);
        lines.extend(problems(&self.bag, &self.choice));
        let name = self.bag.path().display();
        for line in lines {
            // If stderr is closed, the message is lost.
            let _ = writeln!(std::io::stderr(), "{name}: {line}");
        }
    }

    pub(crate) fn size_px(&self) -> Option<(u32, u32)> {
        self.choice.size_px
    }

    pub(crate) fn camera(&self) -> Option<v1::Camera> {
        self.choice.camera.as_ref().map(camera_message)
    }

    pub(crate) fn last_sequence(&self) -> u64 {
        self.choice.stamps_ns.len() as u64
    }

    pub(crate) fn count_after(&self, after_sequence: u64) -> usize {
        let after = usize::try_from(after_sequence).unwrap_or(usize::MAX);
        self.choice.stamps_ns.iter().skip(after).flatten().count()
    }

    /// Stamp of the image of a number, if it is used.
    pub(crate) fn stamp_ns(&self, sequence: u64) -> Option<i64> {
        let index = usize::try_from(sequence.checked_sub(1)?).ok()?;
        *self.choice.stamps_ns.get(index)?
    }

    /// Begins to read the images above a number.
    pub(crate) fn read(self: Arc<Self>, after_sequence: u64) -> Reading {
        let (sender, shots) = channel(MOST_AHEAD);
        let thread = tokio::task::spawn_blocking(move || {
            self.bag.read_frames(&self.choice, after_sequence, &mut |_, _| {}, &mut |frame| {
                let waypost_bags::Frame { number, stamp_ns, image, pose } = frame;
                let odometry = pose.as_ref().map(message);
                // The sender may have given up.
                match sender.blocking_send(Shot {
                    sequence: number,
                    stamp_ns,
                    image,
                    odometry,
                    note: String::new(),
                }) {
                    Ok(()) => ControlFlow::Continue(()),
                    Err(_) => ControlFlow::Break(()),
                }
            })
        });
        Reading { shots, thread }
    }
}

/// A bag that is being read.
pub(crate) struct Reading {
    shots: Receiver<Shot>,
    thread: JoinHandle<Result<Joined, BagError>>,
}

impl Reading {
    pub(crate) async fn next(&mut self) -> Option<Shot> {
        self.shots.recv().await
    }

    /// Says why reading ended early, if it did, and how many images have no odometry.
    pub(crate) async fn end(self) -> Result<(), Failure> {
        let Joined { with_pose, without_pose, astray } = joined(self.thread).await?;
        if let Some(told) = without_odometry(without_pose, with_pose + without_pose.all(), astray) {
            // If stderr is closed, the message is lost.
            let _ = writeln!(std::io::stderr(), "{told}");
        }
        Ok(())
    }
}

/// What is used of a bag, a line each.
pub(crate) fn used(choice: &Choice) -> Vec<String> {
    let mut lines = vec![format!("{} images of {}", choice.frame_count(), choice.image_topic)];
    if let Some(odometry) = &choice.odometry {
        lines.push(format!("odometry of {}: the pose of {}", odometry.topic, odometry.base_frame));
    }
    if let (Some(topic), Some(camera)) = (&choice.camera_info_topic, &choice.camera) {
        let mount = camera.base_to_camera.map_or_else(String::new, |pose| format!(", {}", looks(&pose)));
        lines.push(format!("camera of {topic}: {}{mount}", lens_name(&camera.lens)));
    }
    lines
}

/// What is wrong with a bag and what is left out of it, a line each.
pub(crate) fn problems(bag: &Bag, choice: &Choice) -> Vec<String> {
    let mut lines = cut_off(bag);
    if let Some(left_out) = &choice.left_out {
        let waypost_bags::LeftOut { count, first_number, first_log_ns, first_problem } = left_out;
        lines.push(format!(
            "{count} images of {} are left out; the first is number {first_number}, recorded at {first_log_ns} ns: {first_problem}",
            choice.image_topic
        ));
    }
    lines.extend(choice.notes.iter().cloned());
    lines
}

/// Where files of a bag end in the middle, a line each.
pub(crate) fn cut_off(bag: &Bag) -> Vec<String> {
    let told = |cut: &waypost_bags::CutOff| {
        format!("{} is cut off at byte {}; what is before that is used", cut.path.display(), cut.at_byte)
    };
    bag.cut_off().iter().map(told).collect()
}

fn lens_name(lens: &Lens) -> &'static str {
    match lens {
        Lens::Pinhole(_) => "pinhole",
        Lens::Fisheye(_) => "fisheye",
    }
}

/// Where a camera is and looks, so that a wrong transform is seen.
fn looks(pose: &Pose) -> String {
    let [x, y, z, w] = pose.orientation;
    let ahead = [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)];
    // Straight up is no side.
    let has_side = ahead[0].hypot(ahead[1]) > 1e-6;
    let azimuth = if has_side { ahead[1].atan2(ahead[0]).to_degrees().round() } else { 0.0 };
    let elevation = ahead[2].clamp(-1.0, 1.0).asin().to_degrees().round();
    let [x_m, y_m, z_m] = pose.position_m;
    // No minus before a zero.
    let (azimuth, elevation) = (azimuth + 0.0, elevation + 0.0);
    format!("at ({x_m:.2}, {y_m:.2}, {z_m:.2}) m, looking {azimuth:.0}° to the left and {elevation:.0}° up")
}

/// A camera as a session declares it.
pub(crate) fn camera_message(camera: &Camera) -> v1::Camera {
    let Camera { lens, size_px: (width, height), base_to_camera } = camera;
    let model = match lens.clone() {
        Lens::Pinhole(waypost_bags::Intrinsics { fx_px, fy_px, cx_px, cy_px, distortion }) => {
            v1::camera::Model::Pinhole(v1::Pinhole { fx_px, fy_px, cx_px, cy_px, distortion })
        }
        Lens::Fisheye(waypost_bags::Intrinsics { fx_px, fy_px, cx_px, cy_px, distortion }) => {
            v1::camera::Model::Fisheye(v1::Fisheye { fx_px, fy_px, cx_px, cy_px, distortion })
        }
    };
    v1::Camera {
        model: Some(model),
        image_width_px: Some(*width),
        image_height_px: Some(*height),
        base_to_camera: base_to_camera.as_ref().map(pose_message),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_camera_says_where_it_looks() {
        let half = std::f64::consts::FRAC_1_SQRT_2;
        let left = Pose { position_m: [0.2, 0.1, 0.3], orientation: [0.0, 0.0, half, half] };
        assert_eq!(looks(&left), "at (0.20, 0.10, 0.30) m, looking 90° to the left and 0° up");
        let up = Pose { orientation: [0.0, -half, 0.0, half], ..left };
        assert_eq!(looks(&up), "at (0.20, 0.10, 0.30) m, looking 0° to the left and 90° up");
    }
}
