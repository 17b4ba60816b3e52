//! Nav2's action `NavigateToPose`, as far as Humble and later have it in common.

use serde::{Deserialize, Serialize};

use crate::messages::{CdrError, PoseStamped, Time, decoded};
use crate::services::Service;

/// Tells a goal from others.
pub type GoalId = [u8; 16];

/// What is asked of `send_goal`.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct GoalWanted {
    /// Chosen by whoever sends it.
    pub goal_id: GoalId,
    /// Where the robot is to be.
    pub pose: PoseStamped,
    /// Empty for Nav2's own.
    pub behavior_tree: String,
}

/// What `send_goal` answers.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct GoalTaken {
    /// Whether it is.
    pub accepted: bool,
    /// When.
    pub stamp: Time,
}

/// nav2_msgs/NavigateToPose's `send_goal`
pub struct SendGoal;

impl Service for SendGoal {
    const TYPE: &'static str = "nav2_msgs/action/NavigateToPose_SendGoal";
    type Request = GoalWanted;
    type Response = GoalTaken;
}

/// What is asked of `get_result`.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct ResultWanted {
    /// Of which goal.
    pub goal_id: GoalId,
}

/// nav2_msgs/NavigateToPose's `get_result`, which answers when the goal is over; [`Outcome::read`] has all of that.
pub struct GetResult;

impl Service for GetResult {
    const TYPE: &'static str = "nav2_msgs/action/NavigateToPose_GetResult";
    type Request = ResultWanted;
    type Response = i8;
}

/// What became of a goal.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// The robot is there.
    Succeeded,
    /// It was cancelled, by whoever.
    Canceled,
    /// Nav2 gave up; with its code, 0 if it has none (Humble), and what it says (Jazzy and later).
    Aborted {
        /// By nav2_msgs.
        code: u16,
        /// Empty if nothing is said.
        message: String,
    },
}

/// What action_msgs/GoalStatus calls these.
const SUCCEEDED: i8 = 4;
const CANCELED: i8 = 5;

impl Outcome {
    /// Of what `get_result` answers, behind its four bytes of encapsulation.
    ///
    /// # Errors
    /// If it is something else.
    pub fn read(data: &[u8]) -> Result<Self, CdrError> {
        let (status, code, message) = decoded::<(i8, u16, String)>(data)
            .or_else(|_older| decoded::<(i8, u16)>(data).map(|(status, code)| (status, code, String::new())))
            .or_else(|_oldest| decoded::<i8>(data).map(|status| (status, 0, String::new())))?;
        Ok(match status {
            SUCCEEDED => Self::Succeeded,
            CANCELED => Self::Canceled,
            _ => Self::Aborted { code, message },
        })
    }
}

/// What is asked of action_msgs/CancelGoal.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct CancelWanted {
    /// Which goal.
    pub goal_id: GoalId,
    /// Zero, for that goal alone.
    pub stamp: Time,
}

/// action_msgs/CancelGoal, whose answer is 0 if the goal is being cancelled.
pub struct CancelGoal;

impl Service for CancelGoal {
    const TYPE: &'static str = "action_msgs/srv/CancelGoal";
    type Request = CancelWanted;
    type Response = i8;
}

/// The type of what Nav2 tells on its way.
pub const FEEDBACK: &str = "nav2_msgs/action/NavigateToPose_FeedbackMessage";

/// What Nav2 tells on its way.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Feedback {
    /// Of which goal.
    pub goal_id: GoalId,
    /// Where the robot is.
    pub current_pose: PoseStamped,
    /// For how long it has been on its way.
    pub navigation_time: Time,
    /// Nav2's guess.
    pub estimated_time_remaining: Time,
    /// How often it did not get on.
    pub number_of_recoveries: i16,
    /// Metres along its way.
    pub distance_remaining: f32,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::laid_out;

    fn read<T: Serialize>(told: &T) -> Outcome {
        Outcome::read(&[&[0, 1, 0, 0][..], &laid_out(told).unwrap()].concat()).unwrap()
    }

    #[test]
    fn results_of_each_release_are_read() {
        // Humble has an empty message, which is a byte; Iron a code; Jazzy a text behind it.
        assert_eq!(read(&(4_i8, 0_u8)), Outcome::Succeeded);
        assert_eq!(read(&(5_i8, 0_u16)), Outcome::Canceled);
        assert_eq!(read(&(6_i8, 0_u8)), Outcome::Aborted { code: 0, message: String::new() });
        assert_eq!(read(&(6_i8, 9_u16)), Outcome::Aborted { code: 9, message: String::new() });
        let message = "no path".to_owned();
        assert_eq!(read(&(6_i8, 9_u16, message.clone())), Outcome::Aborted { code: 9, message });
    }
}
