//! What the application asked for, in order, until the server has it and did not refuse it.

use std::collections::VecDeque;

use prost::Message;
use waypost_proto::v1;
use waypost_proto::v1::goal::Target;
use waypost_proto::v1::navigate_request::Content as Request;

/// More goals than a server refuses in a row. Of more, the oldest are forgotten.
const MOST_GOALS: usize = 4;

/// Goals and stops that were asked for.
///
/// The server looks a goal up, which takes a moment. It says when it refuses one, and then goes on
/// to the one before; it does not say when it takes one.
#[derive(Debug, Default)]
pub(super) struct AskedGoals {
    /// Goals that the server has got since it was stopped and has not refused. It goes by the last.
    said: VecDeque<v1::Goal>,
    /// What the server may not have got. A stop is the first: what was asked for before it no
    /// longer counts.
    unsaid: VecDeque<Unsaid>,
    /// Stamp of the last report or frame.
    last_stamp_ns: i64,
    /// Whether the robot has arrived: with the next goal the server forgets this one.
    has_arrived: bool,
}

#[derive(Debug)]
struct Unsaid {
    wish: Wish,
    /// Stamp of the last report or frame before it. Requests are taken in order: with an answer to
    /// a later one, it has arrived.
    after_stamp_ns: i64,
}

#[derive(Debug)]
enum Wish {
    Go(v1::Goal),
    Stop,
}

impl AskedGoals {
    /// Of a navigation that is opened with this goal.
    pub(super) fn new(first: Option<v1::Goal>) -> Self {
        Self { said: first.into_iter().collect(), ..Self::default() }
    }

    /// A report or a frame of this stamp is sent, after all that was asked for so far.
    pub(super) fn stamped(&mut self, stamp_ns: i64) {
        self.last_stamp_ns = self.last_stamp_ns.max(stamp_ns);
    }

    pub(super) fn go_to(&mut self, goal: v1::Goal) {
        if self.has_arrived {
            self.said.clear();
        }
        if self.unsaid.len() == MOST_GOALS {
            // A stop stays.
            self.unsaid.remove(usize::from(self.is_stopping()));
        }
        self.ask(Wish::Go(goal));
    }

    pub(super) fn stop(&mut self) {
        self.unsaid.clear();
        self.ask(Wish::Stop);
    }

    fn ask(&mut self, wish: Wish) {
        self.unsaid.push_back(Unsaid { wish, after_stamp_ns: self.last_stamp_ns });
    }

    /// The server answered a report or a frame.
    pub(super) fn guided(&mut self, guidance: &v1::Guidance) {
        let is_earlier = |asked: &mut Unsaid| asked.after_stamp_ns < guidance.stamp_ns;
        while let Some(Unsaid { wish, after_stamp_ns: _ }) = self.unsaid.pop_front_if(is_earlier) {
            match wish {
                Wish::Go(goal) => self.said.push_back(goal),
                Wish::Stop => self.said.clear(),
            }
        }
        while self.said.len() > MOST_GOALS {
            self.said.pop_front();
        }
        self.has_arrived = guidance.status() == v1::NavigationStatus::Arrived;
    }

    /// The server refused a goal; it names none if that is an image.
    pub(super) fn refused(&mut self, refused: Option<&v1::Goal>) {
        if let Some(at) = self.unsaid.iter().position(|unsaid| unsaid.wish.is_to(refused)) {
            self.unsaid.remove(at);
        } else if let Some(at) = self.said.iter().rposition(|said| is_same(said, refused)) {
            self.said.remove(at);
        } else if self.said.back().is_some_and(|said| may_stand_for(said, refused)) {
            self.said.pop_back();
        }
    }

    /// What a restarted server is told, which knows of no goal.
    pub(super) fn for_opening(&self) -> Option<v1::Goal> {
        if self.is_stopping() { None } else { self.said.back().cloned() }
    }

    /// What the server may not have got, in order.
    pub(super) fn unsaid(&self) -> Vec<Request> {
        self.unsaid.iter().map(|unsaid| unsaid.wish.request()).collect()
    }

    /// Whether the robot is to stand, and the server may not know it.
    pub(super) fn is_stopping(&self) -> bool {
        self.unsaid.front().is_some_and(|first| match first.wish {
            Wish::Stop => true,
            Wish::Go(_) => false,
        })
    }
}

impl Wish {
    fn is_to(&self, refused: Option<&v1::Goal>) -> bool {
        match self {
            Wish::Go(goal) => is_same(goal, refused),
            Wish::Stop => false,
        }
    }

    fn request(&self) -> Request {
        match self {
            Wish::Go(goal) => Request::Goal(goal.clone()),
            Wish::Stop => Request::Stop(v1::StopNavigation {}),
        }
    }
}

fn is_same(asked: &v1::Goal, refused: Option<&v1::Goal>) -> bool {
    match refused {
        // By their bytes, since a number that is none does not equal itself.
        Some(refused) => asked.encode_to_vec() == refused.encode_to_vec(),
        None => matches!(asked.target, Some(Target::Image(_))),
    }
}

/// If no way leads to a label, the server names the place that has it.
fn may_stand_for(asked: &v1::Goal, refused: Option<&v1::Goal>) -> bool {
    let is_place = matches!(refused.and_then(|goal| goal.target.as_ref()), Some(Target::PlaceNumber(_)));
    is_place && matches!(asked.target, Some(Target::Label(_)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn place(number: u32) -> v1::Goal {
        v1::Goal { target: Some(Target::PlaceNumber(number)) }
    }

    fn label(name: &str) -> v1::Goal {
        v1::Goal { target: Some(Target::Label(name.to_owned())) }
    }

    fn image() -> v1::Goal {
        v1::Goal { target: Some(Target::Image(vec![0xff])) }
    }

    fn guidance(stamp_ns: i64) -> v1::Guidance {
        v1::Guidance { stamp_ns, ..v1::Guidance::default() }
    }

    /// Sends a report and takes the answer to it.
    fn report(goals: &mut AskedGoals, stamp_ns: i64) {
        goals.stamped(stamp_ns);
        goals.guided(&guidance(stamp_ns));
    }

    fn stop() -> Request {
        Request::Stop(v1::StopNavigation {})
    }

    #[test]
    fn what_was_asked_for_is_unsaid_until_a_later_report_is_answered() {
        let mut goals = AskedGoals::new(Some(place(1)));
        goals.stamped(10);
        goals.go_to(place(2));
        goals.stamped(20);
        goals.guided(&guidance(10));
        assert_eq!(goals.unsaid(), [Request::Goal(place(2))]);
        assert_eq!(goals.for_opening(), Some(place(1)), "it may yet be refused");
        goals.guided(&guidance(20));
        assert_eq!(goals.unsaid(), []);
        assert_eq!(goals.for_opening(), Some(place(2)));
        goals.stop();
        assert!(goals.is_stopping());
        assert_eq!(goals.for_opening(), None);
        report(&mut goals, 30);
        assert!(!goals.is_stopping());
        assert_eq!(goals.for_opening(), None);
    }

    #[test]
    fn a_stop_outlives_the_goals_around_it() {
        let mut goals = AskedGoals::new(Some(place(1)));
        goals.go_to(label("nowhere"));
        goals.stop();
        goals.go_to(place(2));
        goals.refused(Some(&label("nowhere")));
        assert_eq!(goals.unsaid(), [stop(), Request::Goal(place(2))]);
        goals.refused(Some(&place(2)));
        assert_eq!(goals.unsaid(), [stop()]);
        assert_eq!(goals.for_opening(), None);
        for number in 0..100 {
            goals.go_to(place(number));
        }
        assert_eq!(goals.unsaid().len(), MOST_GOALS);
        assert_eq!(goals.unsaid().first(), Some(&stop()));
        assert_eq!(goals.unsaid().last(), Some(&Request::Goal(place(99))));
    }

    #[test]
    fn a_refusal_takes_no_other_goal_away() {
        for is_answered_first in [false, true] {
            let mut goals = AskedGoals::new(Some(place(3)));
            let wrong = [label("nowhere"), image(), place(9999)];
            for goal in wrong.clone() {
                goals.go_to(goal);
            }
            if is_answered_first {
                report(&mut goals, 1);
            }
            for goal in wrong {
                goals.refused(Some(&goal).filter(|goal| **goal != image()));
            }
            assert_eq!(goals.unsaid(), []);
            assert_eq!(goals.for_opening(), Some(place(3)));
        }
    }

    #[test]
    fn a_position_that_is_no_number_is_known_again() {
        let nowhere = v1::PositionGoal { x_m: Some(f64::NAN), ..v1::PositionGoal::default() };
        let nowhere = v1::Goal { target: Some(Target::Position(nowhere)) };
        let mut goals = AskedGoals::default();
        goals.go_to(nowhere.clone());
        goals.refused(Some(&nowhere));
        assert_eq!(goals.unsaid(), []);
    }

    #[test]
    fn a_label_is_refused_by_its_place_once_the_server_looked_it_up() {
        let mut goals = AskedGoals::new(Some(label("dock")));
        goals.go_to(label("nowhere"));
        goals.refused(Some(&place(4)));
        assert_eq!(goals.for_opening(), None);
        assert_eq!(goals.unsaid(), [Request::Goal(label("nowhere"))]);
    }

    #[test]
    fn a_goal_that_was_reached_is_not_returned_to() {
        let mut goals = AskedGoals::new(Some(place(1)));
        goals.guided(&v1::Guidance { status: v1::NavigationStatus::Arrived.into(), ..guidance(1) });
        assert_eq!(goals.for_opening(), Some(place(1)));
        goals.go_to(place(2));
        goals.refused(Some(&place(2)));
        assert_eq!(goals.for_opening(), None);
    }

    #[test]
    fn few_goals_are_kept() {
        let mut goals = AskedGoals::default();
        for number in 0..100 {
            goals.go_to(place(number));
            report(&mut goals, i64::from(number) + 1);
        }
        assert_eq!(goals.said.len(), MOST_GOALS);
        assert_eq!(goals.for_opening(), Some(place(99)));
    }
}
