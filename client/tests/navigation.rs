//! Navigations over links that break: what the robot was asked to do outlives them.
#![allow(clippy::unwrap_used, clippy::expect_used, missing_docs)]

use std::time::Duration;

use tokio::net::TcpListener;
use tokio::sync::mpsc;
use tokio::time::timeout;
use tokio_stream::wrappers::{TcpListenerStream, UnboundedReceiverStream};
use tonic::transport::Server;
use tonic::{Request, Response, Status, Streaming};
use waypost_client::{Client, Command, Navigation, NavigationEvent, NavigationOptions, Reconnection, v1};
use waypost_proto::v1::navigate_request::Content as Asked;
use waypost_proto::v1::navigate_response::Content as Told;
use waypost_proto::v1::navigation_service_server::{NavigationService, NavigationServiceServer};

/// A server whose streams the test itself answers.
struct Peer {
    endpoint: String,
    streams: mpsc::UnboundedReceiver<Stream>,
}

/// The server's side of a stream. When it is dropped, the stream is cut off.
struct Stream {
    opening: v1::OpenNavigation,
    requests: Streaming<v1::NavigateRequest>,
    answers: mpsc::UnboundedSender<Result<v1::NavigateResponse, Status>>,
}

impl Peer {
    async fn start() -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let endpoint = format!("http://{}", listener.local_addr().unwrap());
        let (opened, streams) = mpsc::unbounded_channel();
        let service = NavigationServiceServer::new(Navigations { opened });
        tokio::spawn(
            Server::builder().add_service(service).serve_with_incoming(TcpListenerStream::new(listener)),
        );
        Self { endpoint, streams }
    }

    /// The next stream of the robot, opened for it.
    async fn stream(&mut self, answer: v1::NavigationOpened) -> Stream {
        let stream = in_time(self.streams.recv()).await.unwrap();
        stream.tell(Told::Opened(answer));
        stream
    }

    /// A navigation to a place, and its stream. The robot drives.
    async fn led_to(&mut self, goal: v1::Goal) -> (Navigation, Stream) {
        let client = Client::lazy(&self.endpoint).unwrap();
        let reconnection = Reconnection { first_delay: Duration::from_millis(2), ..Reconnection::default() };
        let options = NavigationOptions {
            goal: Some(goal),
            reconnection,
            ..NavigationOptions::new("hall", v1::Camera::default())
        };
        let (navigation, stream) = tokio::join!(client.navigate(options), self.stream(anew()));
        let (navigation, mut stream) = (navigation.unwrap(), stream);
        navigation.report_reflex(1, false);
        assert_eq!(stream.report().await, 1);
        stream.guide(1);
        in_time(navigation.guidance().changed()).await.unwrap();
        assert!(drives(&navigation));
        (navigation, stream)
    }
}

impl Stream {
    fn tell(&self, content: Told) {
        self.answers.send(Ok(v1::NavigateResponse { content: Some(content) })).unwrap();
    }

    /// The next request.
    async fn asked(&mut self) -> Asked {
        in_time(self.requests.message()).await.unwrap().unwrap().content.unwrap()
    }

    /// The stamp of the next request, which is a report.
    async fn report(&mut self) -> i64 {
        let asked = self.asked().await;
        let Asked::Wheels(report) = asked else { panic!("{asked:?}") };
        report.stamp_ns
    }

    /// Answers a report with a command to drive.
    fn guide(&self, stamp_ns: i64) {
        let command = v1::VelocityCommand { forward_m_s: 1.0, valid_ns: i64::MAX, ..Default::default() };
        self.tell(Told::Guidance(v1::Guidance { stamp_ns, command: Some(command), ..Default::default() }));
    }

    fn refuse(&self, goal: v1::Goal) {
        self.tell(Told::GoalRefusal(v1::GoalRefusal { goal: Some(goal), status: None }));
    }
}

fn anew() -> v1::NavigationOpened {
    v1::NavigationOpened { navigation: "maps/hall/navigations/robot".to_owned(), ..Default::default() }
}

fn resumed() -> v1::NavigationOpened {
    v1::NavigationOpened { resumed: true, ..anew() }
}

fn place(number: u32) -> v1::Goal {
    v1::Goal { target: Some(v1::goal::Target::PlaceNumber(number)) }
}

fn drives(navigation: &Navigation) -> bool {
    navigation.command() != Command::default()
}

async fn in_time<T>(future: impl Future<Output = T>) -> T {
    timeout(Duration::from_secs(20), future).await.expect("it takes too long")
}

/// The next event that is not of the connection.
async fn told(navigation: &mut Navigation) -> NavigationEvent {
    loop {
        let event = in_time(navigation.next()).await.unwrap().unwrap();
        match event {
            NavigationEvent::Disconnected { .. } | NavigationEvent::Reconnected { .. } => {}
            NavigationEvent::Seen(_)
            | NavigationEvent::FrameRefused(_)
            | NavigationEvent::WheelsRefused(_)
            | NavigationEvent::GoalRefused(_) => return event,
        }
    }
}

/// Waits until the connection is back.
async fn back(navigation: &mut Navigation) {
    while !matches!(in_time(navigation.next()).await.unwrap().unwrap(), NavigationEvent::Reconnected { .. }) {
    }
}

#[tokio::test]
async fn a_stop_that_a_dead_link_swallowed_is_sent_again() {
    let mut peer = Peer::start().await;
    let (mut navigation, stream) = peer.led_to(place(1)).await;
    navigation.stop().await.unwrap();
    navigation.report_reflex(2, false);
    // It does not read any more. A command that was under way is not for a robot that is to stand.
    let stopped = async {
        while drives(&navigation) {
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
    };
    in_time(stopped).await;
    stream.guide(1);
    stream.tell(Told::Seen(v1::FrameSeen::default()));
    told(&mut navigation).await;
    assert!(!drives(&navigation));
    drop(stream);

    let mut stream = peer.stream(resumed()).await;
    assert_eq!(stream.opening.goal, None);
    assert_eq!(stream.asked().await, Asked::Stop(v1::StopNavigation {}));
    back(&mut navigation).await;
    navigation.report_reflex(3, false);
    assert_eq!(stream.report().await, 3);
    stream.guide(3);
    in_time(navigation.guidance().wait_for(|told| told.as_ref().unwrap().stamp_ns == 3)).await.unwrap();
    // What it says now it says in the knowledge of the stop.
    assert!(drives(&navigation));
    drop(stream);

    let mut stream = peer.stream(resumed()).await;
    assert_eq!(stream.opening.goal, None);
    back(&mut navigation).await;
    navigation.report_reflex(4, false);
    assert_eq!(stream.report().await, 4);
}

#[tokio::test]
async fn goals_that_a_dead_link_swallowed_are_sent_again_in_order() {
    let mut peer = Peer::start().await;
    let (mut navigation, stream) = peer.led_to(place(1)).await;
    navigation.go_to(place(2)).await.unwrap();
    navigation.go_to(place(3)).await.unwrap();
    navigation.report_reflex(2, false);
    drop(stream);
    // While it is away, too.
    navigation.go_to(place(4)).await.unwrap();

    let mut stream = peer.stream(resumed()).await;
    // Any of the others may yet be refused.
    assert_eq!(stream.opening.goal, Some(place(1)));
    for number in [2, 3, 4] {
        assert_eq!(stream.asked().await, Asked::Goal(place(number)));
    }
    navigation.report_reflex(3, false);
    assert_eq!(stream.report().await, 3);
    stream.guide(3);
    in_time(navigation.guidance().wait_for(|told| told.as_ref().unwrap().stamp_ns == 3)).await.unwrap();
    drop(stream);
    assert_eq!(peer.stream(anew()).await.opening.goal, Some(place(4)));
}

#[tokio::test]
async fn a_restarted_server_is_told_the_goal_that_was_not_refused() {
    let mut peer = Peer::start().await;
    let (mut navigation, mut stream) = peer.led_to(place(1)).await;
    navigation.go_to(place(99)).await.unwrap();
    assert_eq!(stream.asked().await, Asked::Goal(place(99)));
    stream.refuse(place(99));
    told(&mut navigation).await;
    drop(stream);
    let mut stream = peer.stream(anew()).await;
    assert_eq!(stream.opening.goal, Some(place(1)));

    // The same where it looks up for so long that a report is answered before.
    navigation.go_to(place(99)).await.unwrap();
    assert_eq!(stream.asked().await, Asked::Goal(place(99)));
    navigation.report_reflex(2, false);
    assert_eq!(stream.report().await, 2);
    stream.guide(2);
    stream.refuse(place(99));
    told(&mut navigation).await;
    drop(stream);
    assert_eq!(peer.stream(anew()).await.opening.goal, Some(place(1)));
}

#[tokio::test]
async fn a_refusal_does_not_take_a_later_stop_away() {
    let mut peer = Peer::start().await;
    let (mut navigation, stream) = peer.led_to(place(1)).await;
    navigation.go_to(place(99)).await.unwrap();
    navigation.stop().await.unwrap();
    stream.refuse(place(99));
    told(&mut navigation).await;
    drop(stream);
    let mut stream = peer.stream(resumed()).await;
    assert_eq!(stream.opening.goal, None);
    assert_eq!(stream.asked().await, Asked::Stop(v1::StopNavigation {}));
}

/// The service, whose streams go to the test.
struct Navigations {
    opened: mpsc::UnboundedSender<Stream>,
}

#[tonic::async_trait]
impl NavigationService for Navigations {
    type NavigateStream = UnboundedReceiverStream<Result<v1::NavigateResponse, Status>>;

    async fn navigate(
        &self,
        request: Request<Streaming<v1::NavigateRequest>>,
    ) -> Result<Response<Self::NavigateStream>, Status> {
        let mut requests = request.into_inner();
        let Some(Asked::Open(opening)) = requests.message().await?.and_then(|first| first.content) else {
            return Err(Status::invalid_argument("open a navigation first"));
        };
        let (answers, responses) = mpsc::unbounded_channel();
        // A test that is over does not listen.
        let _ = self.opened.send(Stream { opening, requests, answers });
        Ok(Response::new(UnboundedReceiverStream::new(responses)))
    }

    async fn set_goal(
        &self,
        _: Request<v1::SetGoalRequest>,
    ) -> Result<Response<v1::SetGoalResponse>, Status> {
        Err(Status::unimplemented("this peer streams only"))
    }

    async fn cancel_goal(
        &self,
        _: Request<v1::CancelGoalRequest>,
    ) -> Result<Response<v1::CancelGoalResponse>, Status> {
        Err(Status::unimplemented("this peer streams only"))
    }

    async fn get_navigation(
        &self,
        _: Request<v1::GetNavigationRequest>,
    ) -> Result<Response<v1::Navigation>, Status> {
        Err(Status::unimplemented("this peer streams only"))
    }

    async fn list_navigations(
        &self,
        _: Request<v1::ListNavigationsRequest>,
    ) -> Result<Response<v1::ListNavigationsResponse>, Status> {
        Err(Status::unimplemented("this peer streams only"))
    }

    async fn plan_route(
        &self,
        _: Request<v1::PlanRouteRequest>,
    ) -> Result<Response<v1::PlanRouteResponse>, Status> {
        Err(Status::unimplemented("this peer streams only"))
    }
}
