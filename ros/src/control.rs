//! What a robot asks of the bridge by ROS 2's services: which map, to map or to localize, and when a session is over.

use std::time::Duration;

use tokio::sync::watch;
use tokio::task::JoinHandle;
use tokio::time::Instant;
use waypost_client::{Client, Code, Error, v1};
use waypost_ros_messages::{
    Done, GetParameters, List, ListParameters, Parameter, ParameterValue, Results, Set, SetBool,
    SetParameters, Switch, Trigger, Values, Wanted,
};

use crate::bus::{Bus, BusError};
use crate::calls::Calls;
use crate::diagnostics::how_to_choose;
use crate::plan::Plan;
use crate::sessions::LAST_FRAMES;
use crate::settings::{Mode, Services};
use crate::state::Shared;

const MAP: &str = "map";
const SESSION: &str = "session";
const LOCALIZE: &str = "localize";
const PARAMETERS: [&str; 3] = [LOCALIZE, MAP, SESSION];
/// For a server to say whether it has a map.
const SERVER_PATIENCE: Duration = Duration::from_secs(5);
/// For a session to be open; whoever calls does not wait longer.
const OPENING_PATIENCE: Duration = Duration::from_secs(5);
/// For the last answers of a session, behind the last frames.
const CLOSING_PATIENCE: Duration = LAST_FRAMES.saturating_add(Duration::from_secs(5));
const LOOKING_PERIOD: Duration = Duration::from_millis(20);

/// Changes the plan as it is asked to.
#[derive(Clone)]
pub(crate) struct Control {
    pub(crate) client: Client,
    pub(crate) shared: Shared,
    pub(crate) plans: watch::Sender<Plan>,
    pub(crate) services: Services,
}

impl Control {
    /// Serves all of it until the bridge ends.
    pub(crate) fn serve(self, bus: &Bus) -> Result<Vec<JoinHandle<()>>, BusError> {
        let Services { localize, start, finish, set_parameters, get_parameters, list_parameters } =
            &self.services;
        let changes = self.clone().changes(
            Calls::serve(bus, localize)?,
            Calls::serve(bus, start)?,
            Calls::serve(bus, finish)?,
            Calls::serve(bus, set_parameters)?,
        );
        let told = self.clone().tell(Calls::serve(bus, get_parameters)?, Calls::serve(bus, list_parameters)?);
        Ok(vec![tokio::spawn(changes), tokio::spawn(told)])
    }

    /// One change after another.
    async fn changes(
        self,
        mut localize: Calls<SetBool>,
        mut start: Calls<Trigger>,
        mut finish: Calls<Trigger>,
        mut set: Calls<SetParameters>,
    ) {
        loop {
            tokio::select! {
                Some(call) = localize.next() => {
                    let Switch { data } = call.request;
                    localize.answer(call, &done(self.localize(data).await)).await;
                }
                Some(call) = start.next() => start.answer(call, &done(self.start().await)).await,
                Some(call) = finish.next() => finish.answer(call, &done(self.finish().await)).await,
                Some(call) = set.next() => {
                    let results = self.set(&call.request).await;
                    set.answer(call, &Results { results }).await;
                }
                else => return,
            }
        }
    }

    /// What is so, at once.
    async fn tell(self, mut get: Calls<GetParameters>, mut list: Calls<ListParameters>) {
        loop {
            tokio::select! {
                Some(call) = get.next() => {
                    let values = call.request.names.iter().map(|name| self.value(name)).collect();
                    get.answer(call, &Values { values }).await;
                }
                Some(call) = list.next() => {
                    let prefixes = &call.request.prefixes;
                    let is_asked = |name: &&str| prefixes.is_empty() || prefixes.iter().any(|prefix| prefix == name);
                    let names = PARAMETERS.iter().copied().filter(is_asked).map(str::to_owned).collect();
                    list.answer(call, &List { names, prefixes: Vec::new() }).await;
                }
                else => return,
            }
        }
    }

    fn value(&self, name: &str) -> ParameterValue {
        let plan = self.plans.borrow().clone();
        match name {
            MAP => ParameterValue::of_text(plan.map.as_deref().unwrap_or_default()),
            SESSION => {
                let open = self.shared.lock().session.clone();
                let open = open.as_deref().and_then(|session| session.rsplit('/').next());
                ParameterValue::of_text(open.unwrap_or(&plan.next_session))
            }
            LOCALIZE => ParameterValue::of_switch(plan.mode != Mode::Map),
            _ => ParameterValue::default(),
        }
    }

    async fn localize(&self, localizes: bool) -> Result<String, String> {
        self.need_map()?;
        let mode = self.mode(localizes)?;
        let turn = self.change(|plan| {
            let is_new = plan.mode != mode || !plan.is_wanted;
            plan.mode = mode;
            plan.is_wanted = true;
            is_new
        });
        self.opened(turn).await
    }

    async fn start(&self) -> Result<String, String> {
        self.need_map()?;
        let turn = self.change(|plan| !std::mem::replace(&mut plan.is_wanted, true));
        self.opened(turn).await
    }

    async fn finish(&self) -> Result<String, String> {
        let answered_before = self.shared.lock().frames.clone();
        if self.plans.borrow().wanted_map().is_none() {
            return Err("no session is open: nothing is to finish".to_owned());
        }
        let was_open = self.shared.lock().session.is_some();
        let turn = self.change(|plan| std::mem::replace(&mut plan.is_wanted, false));
        if !was_open {
            return Ok("no session was open yet, and none is opened".to_owned());
        }
        let name = self.known(turn, CLOSING_PATIENCE).await.unwrap_or_else(|| {
            Err("the session has not ended yet: frames are still being sent, or the server does not answer; what it \
                 has taken is safe"
                .to_owned())
        })?;
        let frames = self.shared.lock().frames.clone();
        let lost = frames.dropped - answered_before.dropped;
        Ok(format!("{name} is finished; {lost} frames could not be sent"))
    }

    async fn set(&self, Wanted { parameters }: &Wanted) -> Vec<Set> {
        let mut results = Vec::new();
        let mut wanted = self.plans.borrow().clone();
        for parameter in parameters {
            results.push(self.checked(parameter, &mut wanted).await);
        }
        let turn = self.change(|plan| {
            let is_new = (&plan.map, plan.mode) != (&wanted.map, wanted.mode);
            let chooses = plan.map != wanted.map;
            plan.map = wanted.map;
            plan.mode = wanted.mode;
            plan.next_session = wanted.next_session;
            plan.is_wanted |= chooses;
            is_new && plan.is_wanted
        });
        let chosen = parameters
            .iter()
            .zip(&mut results)
            .find(|(parameter, result)| result.is_ok() && [MAP, LOCALIZE].contains(&parameter.name.as_str()));
        if let Some((_, result)) = chosen
            && self.plans.borrow().wanted_map().is_some()
        {
            *result = self.opened(turn).await.map(|_name| ());
        }
        let told = |result: Result<(), String>| match result {
            Ok(()) => Set { successful: true, reason: String::new() },
            Err(reason) => Set { successful: false, reason },
        };
        results.into_iter().map(told).collect()
    }

    async fn checked(&self, Parameter { name, value }: &Parameter, wanted: &mut Plan) -> Result<(), String> {
        match name.as_str() {
            MAP => {
                let map = value.text().filter(|map| !map.is_empty());
                let map =
                    map.ok_or_else(|| "map is a text: the name of a map that the server has".to_owned())?;
                self.need_on_server(map).await?;
                wanted.map = Some(map.to_owned());
            }
            SESSION => {
                let session = value.text().ok_or_else(|| {
                    "session is a text: the name of the next session, empty for the server to choose"
                        .to_owned()
                })?;
                session.clone_into(&mut wanted.next_session);
            }
            LOCALIZE => {
                let localizes = value.switch().ok_or_else(|| "localize is true or false".to_owned())?;
                wanted.mode = self.mode(localizes)?;
            }
            other => {
                return Err(format!("there is no parameter `{other}`; there are {}", PARAMETERS.join(", ")));
            }
        }
        Ok(())
    }

    async fn need_on_server(&self, map: &str) -> Result<(), String> {
        let asked = tokio::time::timeout(SERVER_PATIENCE, self.client.map(map, v1::MapView::Basic)).await;
        match asked {
            Ok(Ok(_map)) => Ok(()),
            Ok(Err(Error::Status { code: Code::NotFound, .. })) => Err(format!(
                "the server has no map `{map}`; `waypost map list` names those that it has, and `waypost map create` \
                 makes one"
            )),
            Ok(Err(error)) => Err(error.to_string()),
            Err(_elapsed) => Err("the server does not answer; see that it runs, and call again".to_owned()),
        }
    }

    fn need_map(&self) -> Result<(), String> {
        match self.plans.borrow().map {
            Some(_) => Ok(()),
            None => Err(format!("no map is chosen; {} first", how_to_choose(&self.services))),
        }
    }

    /// The mode that is asked for, if the bridge may go there.
    fn mode(&self, localizes: bool) -> Result<Mode, String> {
        match (self.plans.borrow().mode, localizes) {
            (Mode::Drive, true) => Ok(Mode::Drive),
            (Mode::Drive, false) => Err(
                "the bridge drives the robot along the map, so it has to localize; start it without --drive or --nav2 to map"
                    .to_owned(),
            ),
            (Mode::Map | Mode::Localize, true) => Ok(Mode::Localize),
            (Mode::Map | Mode::Localize, false) => Ok(Mode::Map),
        }
    }

    /// Changes the plan; if that says that a session ends or begins, at a new turn. Gives the turn.
    fn change(&self, how: impl FnOnce(&mut Plan) -> bool) -> u64 {
        let mut turn = 0;
        self.plans.send_modify(|plan| {
            if how(plan) {
                plan.turn += 1;
            }
            turn = plan.turn;
        });
        turn
    }

    /// Waits for the session of a turn to be open.
    async fn opened(&self, turn: u64) -> Result<String, String> {
        match self.known(turn, OPENING_PATIENCE).await {
            Some(Ok(name)) => Ok(format!("{name} is open")),
            Some(Err(problem)) => Err(problem),
            None => Ok("a session is opened as soon as the camera is known and the server answers; /diagnostics says \
                        what is missing"
                .to_owned()),
        }
    }

    /// What became of a turn, if that is known in time.
    async fn known(&self, turn: u64, patience: Duration) -> Option<Result<String, String>> {
        let late = Instant::now() + patience;
        while Instant::now() < late {
            let turned = self.shared.lock().turned.clone();
            if let Some(turned) = turned.filter(|turned| turned.turn == turn) {
                return Some(turned.to);
            }
            tokio::time::sleep(LOOKING_PERIOD).await;
        }
        None
    }
}

fn done(result: Result<String, String>) -> Done {
    match result {
        Ok(message) => Done { success: true, message },
        Err(message) => Done { success: false, message },
    }
}
