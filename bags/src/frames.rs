//! The second reading of a bag: images with odometry, one after another.

use std::ops::ControlFlow;

use crate::bag::Bag;
use crate::choice::{Choice, Clock, OdometrySource};
use crate::error::{BagError, Problem};
use crate::images;
use crate::input::Progress;
use crate::messages::{Kind, Pose, Transform, reader};
use crate::odometry::{Frame, Joining, Lacks, RECORDED};
use crate::source::RawMessage;
use crate::succession::Astray;
use crate::survey::{ODOM_FRAME, pose, readable};

/// Takes frames one after another.
pub type Take<'t> = dyn FnMut(Frame) -> ControlFlow<()> + 't;

/// What became of the frames.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Joined {
    /// Frames with a pose.
    pub with_pose: u64,
    /// Frames without, though there is odometry, by reason.
    pub without_pose: Lacks,
    /// Poses that were left out, and whether their clock was set back.
    pub astray: Astray,
}

impl Bag {
    /// Passes the images of a choice to `take`, above number `after`, until that breaks off.
    ///
    /// # Errors
    /// Where the bag is not any more what it was when it was opened.
    pub fn read_frames(
        &self,
        choice: &Choice,
        after: u64,
        progress: &mut Progress<'_>,
        take: &mut Take<'_>,
    ) -> Result<Joined, BagError> {
        let mut reading = Reading { bag: self, choice, after, number: 0, joining: Joining::new(RECORDED) };
        if choice.odometry.is_none() {
            reading.joining.end();
        }
        let mut joined = Joined::default();
        let mut flow = ControlFlow::Continue(());
        self.visit(progress, &mut |message| {
            reading.message(message)?;
            flow = reading.hand_out(&mut joined, take);
            Ok(flow)
        })?;
        if flow.is_continue() {
            reading.joining.end();
            let _ = reading.hand_out(&mut joined, take);
        }
        if choice.odometry.is_some() {
            joined.without_pose = reading.joining.lacks();
            joined.astray = reading.joining.astray();
        }
        Ok(joined)
    }
}

struct Reading<'a> {
    bag: &'a Bag,
    choice: &'a Choice,
    after: u64,
    /// Of the latest image.
    number: u64,
    joining: Joining,
}

impl Reading<'_> {
    fn message(&mut self, message: &RawMessage<'_>) -> Result<(), BagError> {
        let topic = message.channel.topic.as_str();
        if topic == self.choice.image_topic {
            return self.image(message);
        }
        if let Some(source) = self.choice.odometry.as_ref().filter(|source| source.topic == topic) {
            // What cannot be read is counted in the topic already.
            if let Ok(Some((stamp_ns, pose))) = stamped_pose(source, message) {
                let stamp_ns = self.time_ns(stamp_ns, message.log_ns);
                self.joining.add_pose(message.log_ns, stamp_ns, pose);
            }
        }
        Ok(())
    }

    fn image(&mut self, message: &RawMessage<'_>) -> Result<(), BagError> {
        let changed = || BagError::Changed { path: self.bag.path().to_owned() };
        self.number += 1;
        let index = usize::try_from(self.number - 1).ok();
        let stamp_ns = index.and_then(|index| self.choice.stamps_ns.get(index)).ok_or_else(changed)?;
        let Some(stamp_ns) = stamp_ns.filter(|_| self.number > self.after) else { return Ok(()) };
        let encoding = &message.channel.encoding;
        let file =
            readable(&message.body).and_then(|data| images::file(self.choice.image_kind, encoding, data));
        let image = file.map_err(|_| changed())?;
        let frame = Frame { number: self.number, stamp_ns, image, pose: None };
        self.joining.add_image(message.log_ns, frame);
        Ok(())
    }

    fn time_ns(&self, stamp_ns: i64, log_ns: i64) -> i64 {
        match self.choice.clock {
            Clock::Header => stamp_ns,
            Clock::Log => log_ns,
        }
    }

    fn hand_out(&mut self, joined: &mut Joined, take: &mut Take<'_>) -> ControlFlow<()> {
        while let Some(frame) = self.joining.next() {
            joined.with_pose += u64::from(frame.pose.is_some());
            take(frame)?;
        }
        ControlFlow::Continue(())
    }
}

fn stamped_pose(source: &OdometrySource, message: &RawMessage<'_>) -> Result<Option<(i64, Pose)>, Problem> {
    let data = readable(&message.body)?;
    let encoding = &message.channel.encoding;
    if source.kind != Kind::Transforms {
        let stamped = pose(source.kind, encoding, data)?;
        return Ok(Some((stamped.stamp_ns, stamped.pose.checked()?)));
    }
    let transforms = Transform::read_all(&mut reader(encoding, data)?)?;
    let base = transforms.iter().find(|joint| joint.parent == ODOM_FRAME && joint.child == source.base_frame);
    base.map(|joint| Ok((joint.stamp_ns, joint.pose.checked()?))).transpose()
}
