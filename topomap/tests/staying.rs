//! Whether a robot is still at a place, where no wheels tell.

use fabmap::PlaceId;
use topomap::evidence::TwoView;
use topomap::ids::FrameId;
use topomap::in_memory::Views;
use topomap::log::Reason;

use crate::look_alikes::{World, plane, settings};

/// Much of one place is seen from the next one, too.
struct Overlapping<'a> {
    shows: &'a [u64],
    current: u64,
}

impl Views for Overlapping<'_> {
    fn compare(&self, earlier: FrameId) -> Option<TwoView> {
        let inliers = match self.shows[earlier as usize].abs_diff(self.current) {
            0 => 200,
            1 => 30,
            _ => 3,
        };
        Some(plane(500, inliers, [0.1, 0.0]))
    }

    fn focal_length_widths(&self) -> Option<f64> {
        None
    }
}

#[test]
fn without_wheels_a_robot_goes_on_to_what_views_show_though_words_would_stay() {
    let mut world = World::new(settings());
    for place in 1..=8 {
        world.sees(place, 40);
    }
    for place in [2, 3] {
        assert_eq!(world.sees(place, 200).decision.reason, Reason::LoopClosure);
    }
    let decided = |words, current| {
        let decision = world.decide(words, &Overlapping { shows: &world.shows, current }).decision;
        (decision.reason, decision.place)
    };
    // Words are those of the place where it is, which may still be seen; it is at the next one.
    assert_eq!(decided(3, 4), (Reason::LoopClosure, Some(PlaceId::new(3))));
    assert_eq!(decided(3, 3), (Reason::SamePlace, Some(PlaceId::new(2))));
}
