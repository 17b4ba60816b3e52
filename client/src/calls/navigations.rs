//! Navigations of robots, their goals, and routes.

use waypost_proto::v1;

use crate::client::{Call, Client, map_name};
use crate::error::Error;

impl Client {
    /// Sends a navigating robot to a goal; `name` is `maps/{map}/navigations/{navigation}`.
    ///
    /// # Errors
    /// [`Error::Status`]: NOT_FOUND if there is no such navigation or the image of the goal matches
    /// no place, FAILED_PRECONDITION if the goal does not suit the map.
    pub fn set_goal<'a>(&'a self, name: &'a str, goal: v1::Goal) -> Call<'a, v1::Navigation> {
        Box::pin(async move {
            let request = v1::SetGoalRequest { name: name.to_owned(), goal: Some(goal) };
            let response = self.taken(self.navigations_client().set_goal(request).await)?;
            response.navigation.ok_or(Error::Protocol("it answered without the navigation"))
        })
    }

    /// Cancels the goal of a robot: it stops.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND if there is no such navigation.
    pub fn cancel_goal<'a>(&'a self, name: &'a str) -> Call<'a, v1::Navigation> {
        Box::pin(async move {
            let request = v1::CancelGoalRequest { name: name.to_owned() };
            let response = self.taken(self.navigations_client().cancel_goal(request).await)?;
            response.navigation.ok_or(Error::Protocol("it answered without the navigation"))
        })
    }

    /// A navigation, at present or until a moment ago.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND.
    pub fn navigation<'a>(&'a self, name: &'a str) -> Call<'a, v1::Navigation> {
        Box::pin(async move {
            let request = v1::GetNavigationRequest { name: name.to_owned() };
            self.taken(self.navigations_client().get_navigation(request).await)
        })
    }

    /// All navigations in a map, by name.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND.
    pub fn navigations<'a>(&'a self, map: &'a str) -> Call<'a, Vec<v1::Navigation>> {
        Box::pin(async move {
            self.all_pages(|page_token| async move {
                let request = v1::ListNavigationsRequest { map: map_name(map), page_size: 0, page_token };
                let page = self.navigations_client().list_navigations(request).await?.into_inner();
                Ok((page.navigations, page.next_page_token))
            })
            .await
        })
    }

    /// The route from a place to a goal.
    ///
    /// # Errors
    /// [`Error::Status`]: NOT_FOUND, FAILED_PRECONDITION if there is none.
    pub fn plan_route(&self, request: v1::PlanRouteRequest) -> Call<'_, v1::Route> {
        Box::pin(async move {
            let response = self.taken(self.navigations_client().plan_route(request).await)?;
            response.route.ok_or(Error::Protocol("it answered without a route"))
        })
    }
}
