//! Goals in the order in which they were asked for. Looking one up takes a moment, so that a later one may be there before.

/// Numbers of the goals that one robot was asked to go to, and of the times it was stopped.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct AskedGoals {
    asked: u64,
    /// What the robot goes by; an earlier goal is found too late.
    taken: u64,
    /// The latest that nobody waits for, until it is taken or refused.
    looked_up: Option<u64>,
}

impl AskedGoals {
    /// The number of a goal that is asked for; the caller waits for what becomes of it.
    pub(super) fn ask(&mut self) -> u64 {
        self.asked += 1;
        self.asked
    }

    /// The same where the robot goes on meanwhile, and hears of it in time.
    pub(super) fn ask_in_time(&mut self) -> u64 {
        let number = self.ask();
        self.looked_up = Some(number);
        number
    }

    /// Whether the robot is to go by a goal that was found: not if a later one was taken, or it was stopped.
    pub(super) fn take(&mut self, number: u64) -> bool {
        self.answer(number);
        let is_later = number > self.taken;
        self.taken = self.taken.max(number);
        is_later
    }

    /// A goal was refused. Whether that still concerns the robot.
    pub(super) fn refuse(&mut self, number: u64) -> bool {
        self.answer(number);
        number >= self.taken
    }

    /// The robot is stopped: whatever is looked up comes too late.
    pub(super) fn stop(&mut self) {
        let number = self.ask();
        self.take(number);
    }

    /// What the robot goes by.
    pub(super) fn taken(&self) -> u64 {
        self.taken
    }

    /// Whether a goal is being looked up that the robot may go to.
    pub(super) fn is_looking_up(&self) -> bool {
        self.looked_up.is_some()
    }

    fn answer(&mut self, number: u64) {
        self.looked_up = self.looked_up.filter(|looked_up| *looked_up > number);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_later_goal_is_not_replaced_by_an_earlier_one() {
        let mut goals = AskedGoals::default();
        let [first, second] = [goals.ask(), goals.ask()];
        assert!(goals.take(second));
        assert!(!goals.take(first));
        assert!(!goals.refuse(first));
        goals.stop();
        assert!(!goals.take(second), "it was stopped since");
    }

    #[test]
    fn a_goal_is_looked_up_until_it_is_taken_or_refused() {
        let mut goals = AskedGoals::default();
        let first = goals.ask_in_time();
        assert!(goals.is_looking_up());
        assert!(goals.refuse(first));
        assert!(!goals.is_looking_up());
        let [second, third] = [goals.ask_in_time(), goals.ask_in_time()];
        goals.take(second);
        assert!(goals.is_looking_up(), "the third is");
        goals.stop();
        assert!(!goals.is_looking_up());
        assert!(!goals.refuse(third), "nobody waits for it");
        goals.ask();
        assert!(!goals.is_looking_up(), "its caller may go away");
    }
}
