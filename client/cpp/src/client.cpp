#include "waypost/client.hpp"

#include <algorithm>
#include <chrono>
#include <utility>

#include "connection.hpp"
#include "navigation_exchange.hpp"
#include "session_exchange.hpp"
#include "status.hpp"
#include "waypost/v1/map.grpc.pb.h"

namespace waypost {
namespace {

// As many as the server gives at once.
constexpr std::uint32_t page_size = 1'000;

}  // namespace

Client::Client(std::shared_ptr<const Connection> connection) noexcept : connection_(std::move(connection)) {}

Client Client::connect(ClientOptions options) {
  const Client client = lazy(std::move(options));
  // Any call that reads shows whether there is a server, and whether it takes the token.
  const auto stub = client.stub<v1::MapService>();
  grpc::ClientContext context;
  context.set_deadline(std::chrono::system_clock::now() + client.connection_->connect_timeout());
  v1::ListMapsRequest request;
  request.set_page_size(1);
  v1::ListMapsResponse response;
  client.check(stub->ListMaps(&context, request, &response), context);
  return client;
}

Client Client::lazy(ClientOptions options) { return Client(std::make_shared<const Connection>(options)); }

Session Client::open_session(SessionOptions options) const {
  return Session(std::make_unique<SessionExchange>(connection_, std::move(options)));
}

Navigation Client::navigate(NavigationOptions options) const {
  return Navigation(std::make_unique<NavigationExchange>(connection_, std::move(options)));
}

v1::Map Client::create_map(const std::string& map, const std::string& model, const v1::MapSettings& settings) const {
  v1::CreateMapRequest request;
  request.set_map_id(last_part(map));
  request.set_model(model);
  *request.mutable_settings() = settings;
  return call(&v1::MapService::Stub::CreateMap, request);
}

std::vector<v1::Map> Client::maps() const {
  std::vector<v1::Map> all;
  v1::ListMapsRequest request;
  request.set_page_size(page_size);
  do {
    v1::ListMapsResponse page = call(&v1::MapService::Stub::ListMaps, request);
    std::move(page.mutable_maps()->begin(), page.mutable_maps()->end(), std::back_inserter(all));
    request.set_page_token(page.next_page_token());
  } while (!request.page_token().empty());
  return all;
}

v1::Map Client::map(const std::string& name, v1::MapView view) const {
  v1::GetMapRequest request;
  request.set_name(map_name(name));
  request.set_view(view);
  return call(&v1::MapService::Stub::GetMap, request);
}

std::vector<v1::LoopClosure> Client::loop_closures(const std::string& map) const {
  std::vector<v1::LoopClosure> all;
  v1::ListLoopClosuresRequest request;
  request.set_map(map_name(map));
  request.set_page_size(page_size);
  do {
    v1::ListLoopClosuresResponse page = call(&v1::MapService::Stub::ListLoopClosures, request);
    std::move(page.mutable_loop_closures()->begin(), page.mutable_loop_closures()->end(), std::back_inserter(all));
    request.set_page_token(page.next_page_token());
  } while (!request.page_token().empty());
  return all;
}

std::unique_ptr<grpc::ClientContext> Client::new_context() const {
  auto context = std::make_unique<grpc::ClientContext>();
  context->set_deadline(std::chrono::system_clock::now() + connection_->call_timeout());
  return context;
}

void Client::check(const grpc::Status& status, const grpc::ClientContext& context) const {
  if (status.ok()) return;
  if (is_not_grpc(status)) throw ServerUnreachable(not_grpc(address()));
  // A status that gRPC made up itself has not come with anything over the wire.
  const bool made_here = context.GetServerInitialMetadata().empty() && context.GetServerTrailingMetadata().empty();
  const bool no_answer = status.error_code() == grpc::UNAVAILABLE || status.error_code() == grpc::DEADLINE_EXCEEDED;
  if (made_here && no_answer) {
    throw ServerUnreachable("no connection to " + address() + " (" + status.error_message() +
                            "); check that waypost-server runs there and that the address, and TLS or none, is right");
  }
  error_of(status).raise();
}

std::shared_ptr<grpc::Channel> Client::channel() const { return connection_->channel(); }

const std::string& Client::address() const noexcept { return connection_->address(); }

}  // namespace waypost
