use super::*;

fn frame(sequence: u64) -> FrameInput {
    FrameInput {
        sequence,
        stamp_ns: 0,
        content: FrameContent::Image(vec![1]),
        odometry: None,
        note: String::new(),
    }
}

fn window(sequences: std::ops::RangeInclusive<u64>) -> Window {
    let mut window = Window::default();
    sequences.for_each(|sequence| window.push(frame(sequence)));
    window
}

fn answer(sequence: u64) -> FrameOutcome {
    FrameOutcome::Answer(v1::FrameAnswer { sequence, ..Default::default() })
}

fn refusal(sequence: u64, code: Code) -> FrameOutcome {
    let status = Status { code: code.into(), message: "because".to_owned(), details: Vec::new() };
    FrameOutcome::Refusal(v1::FrameRefusal { sequence, last_committed_sequence: None, status: Some(status) })
}

fn sent(window: &mut Window) -> Vec<u64> {
    std::iter::from_fn(|| window.next_to_send().map(|frame| frame.sequence)).collect()
}

fn taken(window: &mut Window) -> Vec<u64> {
    std::iter::from_fn(|| window.take_outcome().map(|outcome| outcome.sequence())).collect()
}

#[test]
fn outcomes_leave_in_the_order_of_frames() {
    let mut window = window(1..=3);
    assert_eq!(sent(&mut window), [1, 2, 3]);
    assert_eq!(window.settle(answer(2)).unwrap(), Settled::Done);
    assert!(taken(&mut window).is_empty());
    assert_eq!(window.settle(refusal(1, Code::InvalidArgument)).unwrap(), Settled::Done);
    assert_eq!(taken(&mut window), [1, 2]);
    assert_eq!((window.len(), window.last_acknowledged()), (1, Some(2)));
}

#[test]
fn all_frames_without_an_outcome_are_sent_again() {
    let mut window = window(1..=4);
    assert_eq!(sent(&mut window), [1, 2, 3, 4]);
    window.settle(answer(1)).unwrap();
    window.settle(answer(3)).unwrap();
    window.send_again();
    assert_eq!(sent(&mut window), [2, 4]);
}

#[test]
fn nothing_overtakes_a_postponed_frame() {
    let mut window = window(1..=2);
    assert_eq!(sent(&mut window), [1, 2]);
    let settled = window.settle(refusal(1, Code::ResourceExhausted)).unwrap();
    assert_eq!(settled, Settled::Postponed { message: "because".to_owned(), delay: Duration::ZERO });
    window.push(frame(3));
    assert!(sent(&mut window).is_empty());
    assert!(!window.only_postponed_left());
    window.settle(refusal(2, Code::Unavailable)).unwrap();
    assert!(window.only_postponed_left());
    window.release_postponed();
    assert!(!window.only_postponed_left());
    assert_eq!(sent(&mut window), [1]);
}

#[test]
fn after_a_refusal_frames_go_one_by_one_and_then_more_and_more() {
    let mut window = window(1..=9);
    assert_eq!(sent(&mut window).len(), 9);
    for sequence in 1..=9 {
        window.settle(refusal(sequence, Code::Unavailable)).unwrap();
    }
    window.release_postponed();
    assert_eq!(sent(&mut window), [1]);
    window.settle(answer(1)).unwrap();
    assert_eq!(sent(&mut window), [2, 3]);
    // One that is refused for good says nothing of how much the server can take.
    window.settle(refusal(2, Code::InvalidArgument)).unwrap();
    assert_eq!(sent(&mut window), [4]);
    window.settle(answer(3)).unwrap();
    assert_eq!(sent(&mut window), [5, 6, 7]);
    window.settle(answer(4)).unwrap();
    assert_eq!(sent(&mut window), [8, 9]);
}

#[test]
fn the_server_may_say_how_long_to_wait() {
    let hint = RetryInfo { retry_delay: Some(prost_types::Duration { seconds: 1, nanos: 500_000_000 }) };
    let detail = prost_types::Any {
        type_url: "type.googleapis.com/google.rpc.RetryInfo".to_owned(),
        value: hint.encode_to_vec(),
    };
    let status = Status { code: 8, message: String::new(), details: vec![detail] };
    assert_eq!(retry_delay(&status), Duration::from_millis(1500));
}

#[test]
fn an_answer_to_nothing_is_an_error() {
    let mut window = window(1..=1);
    assert!(matches!(window.settle(answer(1)), Err(Error::Protocol(_))));
    assert_eq!(sent(&mut window), [1]);
    window.settle(answer(1)).unwrap();
    assert!(matches!(window.settle(answer(1)), Err(Error::Protocol(_))));
}

#[test]
fn an_image_that_is_too_long_is_refused_in_its_turn() {
    let mut window = window(1..=1);
    window.push(FrameInput { content: FrameContent::Image(vec![0; MAX_IMAGE_BYTES + 1]), ..frame(2) });
    window.push(frame(3));
    assert_eq!(sent(&mut window), [1, 3]);
    window.settle(answer(1)).unwrap();
    assert!(matches!(window.take_outcome(), Some(FrameOutcome::Answer(_))));
    let Some(FrameOutcome::Refusal(refusal)) = window.take_outcome() else { panic!("not refused") };
    assert_eq!(refusal.status.unwrap().code, i32::from(Code::InvalidArgument));
    assert_eq!(window.take_outcome(), None);
}
