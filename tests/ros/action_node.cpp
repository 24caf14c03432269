// A client of skygcs_msgs on Fast DDS alone: it reads the fleet, and sends goals by the protocol of ROS 2's actions.
//
//   action_node DOMAIN fleet
//   action_node DOMAIN goto NAMESPACE X Y Z              until its result
//   action_node DOMAIN cancel NAMESPACE X Y Z METRES     cancelled when so many metres are left
//   action_node DOMAIN takeoff NAMESPACE HEIGHT
//   action_node DOMAIN hostile NAMESPACE                 bytes that are no requests, and results of unknown goals
#include <array>
#include <atomic>
#include <random>

#include "dds_node.hpp"

namespace action = skygcs_msgs::action::dds_;
using Fleet = skygcs_msgs::msg::dds_::Fleet_;
using Uuid = std::array<uint8_t, 16>;

static Uuid new_id() {
  std::random_device random;
  Uuid id;
  for (auto& octet : id) octet = random();
  return id;
}

static int read_fleet(int domain) {
  Node node(domain);
  std::mutex mutex;
  std::vector<Fleet> fleets;
  node.read<Fleet, skygcs_msgs::msg::dds_::Fleet_PubSubType>("rt/skygcs/fleet", true, false, [&](const Fleet& m) {
    std::lock_guard<std::mutex> lock(mutex);
    fleets.push_back(m);
  });
  std::vector<skygcs_msgs::msg::dds_::Event_> events;
  node.read<skygcs_msgs::msg::dds_::Event_, skygcs_msgs::msg::dds_::Event_PubSubType>(
      "rt/skygcs/events", true, true, [&](const skygcs_msgs::msg::dds_::Event_& m) {
        std::lock_guard<std::mutex> lock(mutex);
        events.push_back(m);
      });
  for (double until = now_s() + 30; now_s() < until; pause_s(0.1)) {
    std::lock_guard<std::mutex> lock(mutex);
    if (fleets.size() >= 4 && !events.empty()) break;
  }
  std::lock_guard<std::mutex> lock(mutex);
  if (fleets.empty()) return 1;
  const Fleet& fleet = fleets.back();
  std::printf("fleet %zu %s %d %d\n", fleets.size(), fleet.header().frame_id().c_str(), fleet.daemon_connected(),
              fleet.has_origin());
  for (const auto& row : fleet.vehicles())
    std::printf("vehicle %s %d %s %s %s %.7f %.7f %.2f\n", row.name().c_str(), row.system_id(),
                row.namespace_root().c_str(), row.autopilot().c_str(), row.mode().c_str(), row.lat_deg(),
                row.lon_deg(), row.position().z());
  for (const auto& event : events) std::printf("event %s %s\n", event.kind().c_str(), event.vehicle().c_str());
  return 0;
}

// One action's client, as rclcpp's.
template <class Sent, class SentSupport, class Answer, class AnswerSupport, class Asked, class AskedSupport, class Result,
          class ResultSupport, class Feedback, class FeedbackSupport>
class ActionClient {
public:
  Client<Sent, Answer, SentSupport, AnswerSupport> goals;
  Client<action_msgs::srv::dds_::CancelGoal_Request_, action_msgs::srv::dds_::CancelGoal_Response_,
         action_msgs::srv::dds_::CancelGoal_Request_PubSubType, action_msgs::srv::dds_::CancelGoal_Response_PubSubType>
      cancels;
  Client<Asked, Result, AskedSupport, ResultSupport> results;
  std::function<void(const Feedback&)> on_feedback;

  ActionClient(Node& node, const std::string& name)
      : goals(node, name + "/_action/send_goal"),
        cancels(node, name + "/_action/cancel_goal"),
        results(node, name + "/_action/get_result") {
    node.read<Feedback, FeedbackSupport>("rt" + name + "/_action/feedback", true, false, [this](const Feedback& m) {
      if (m.goal_id().uuid() == id && on_feedback) on_feedback(m);
    });
    node.read<action_msgs::msg::dds_::GoalStatusArray_, action_msgs::msg::dds_::GoalStatusArray_PubSubType>(
        "rt" + name + "/_action/status", true, true, [this](const action_msgs::msg::dds_::GoalStatusArray_& m) {
          for (const auto& one : m.status_list())
            if (one.goal_info().goal_id().uuid() == id) status = one.status();
        });
  }

  bool send(Sent goal) {
    id = new_id();
    goal.goal_id().uuid(id);
    Answer answer;
    bool answered = goals.call(goal, answer);
    std::printf("accepted %d\n", answered && answer.accepted());
    return answered && answer.accepted();
  }

  bool cancel() {
    action_msgs::srv::dds_::CancelGoal_Request_ request;
    request.goal_info().goal_id().uuid(id);
    action_msgs::srv::dds_::CancelGoal_Response_ response;
    bool answered = cancels.call(request, response);
    std::printf("cancel %d %zu\n", answered ? response.return_code() : -1, response.goals_canceling().size());
    return answered;
  }

  bool result(Result& response, double timeout_s = 180) {
    Asked request;
    request.goal_id().uuid(id);
    results.ask(request);
    std::printf("asked\n");
    bool answered = results.wait(response, timeout_s);
    for (double until = now_s() + 5; answered && status != response.status() && now_s() < until;) pause_s(0.02);
    std::printf("status %d %d\n", answered ? response.status() : -1, static_cast<int>(status));
    return answered;
  }

private:
  Uuid id{};
  std::atomic<int> status{0};
};

#define ACTION(NAME)                                                                                             \
  ActionClient<action::NAME##_SendGoal_Request_, action::NAME##_SendGoal_Request_PubSubType,                    \
               action::NAME##_SendGoal_Response_, action::NAME##_SendGoal_Response_PubSubType,                  \
               action::NAME##_GetResult_Request_, action::NAME##_GetResult_Request_PubSubType,                  \
               action::NAME##_GetResult_Response_, action::NAME##_GetResult_Response_PubSubType,                \
               action::NAME##_FeedbackMessage_, action::NAME##_FeedbackMessage_PubSubType>

static int go(int domain, const std::string& ns, const double (&place)[3], double cancel_at_m) {
  Node node(domain);
  ACTION(Goto) client(node, ns + "/skygcs/goto");
  std::atomic<double> left{1e9};
  std::atomic<int> count{0};
  client.on_feedback = [&](const action::Goto_FeedbackMessage_& m) {
    if (count++ == 0) std::printf("first %.1f %.1f\n", m.feedback().distance_m(), m.feedback().height_m());
    left = m.feedback().distance_m();
  };
  pause_s(2);  // everything is matched
  action::Goto_SendGoal_Request_ goal;
  goal.goal().position().x(place[0]);
  goal.goal().position().y(place[1]);
  goal.goal().position().z(place[2]);
  if (!client.send(goal)) return 1;
  if (cancel_at_m > 0) {
    for (double until = now_s() + 120; left > cancel_at_m && now_s() < until;) pause_s(0.02);
    client.cancel();
  }
  action::Goto_GetResult_Response_ response;
  if (!client.result(response)) return 1;
  std::printf("feedback %d %.1f\n", static_cast<int>(count), static_cast<double>(left));
  std::printf("result %d %.1f %s\n", response.result().ok(), response.result().distance_m(),
              response.result().reason().c_str());
  return 0;
}

static int take_off(int domain, const std::string& ns, double height_m) {
  Node node(domain);
  ACTION(Takeoff) client(node, ns + "/skygcs/takeoff");
  pause_s(2);
  action::Takeoff_SendGoal_Request_ goal;
  goal.goal().height_m(height_m);
  goal.goal().arm(true);
  double until = now_s() + 120;
  while (!client.send(goal)) {  // the autopilot is not ready yet
    if (now_s() > until) return 1;
    pause_s(3);
  }
  action::Takeoff_GetResult_Response_ response;
  if (!client.result(response)) return 1;
  std::printf("result %d %.1f %s\n", response.result().ok(), response.result().height_m(),
              response.result().reason().c_str());
  return 0;
}

// A header under the name of a request: what its bytes are is no request.
struct Posing : std_msgs::msg::dds_::Header_PubSubType {
  Posing() { setName("skygcs_msgs::action::dds_::Goto_SendGoal_Request_"); }
};

static int hostile(int domain, const std::string& ns) {
  Node node(domain), other_node(domain);
  ACTION(Goto) client(node, ns + "/skygcs/goto");
  auto* goals = other_node.write<Posing>("rq" + ns + "/skygcs/goto/_action/send_goalRequest");
  pause_s(2);
  for (int i = 0; i < 1000; i++) {
    std_msgs::msg::dds_::Header_ other;
    other.frame_id(std::string(i, 'x'));
    goals->write(&other);
  }
  int unknown = 0;
  for (int i = 0; i < 100; i++) {
    action::Goto_GetResult_Request_ request;
    request.goal_id().uuid(new_id());
    action::Goto_GetResult_Response_ response;
    if (client.results.call(request, response, 10) && response.status() == 0) unknown++;
  }
  std::printf("unknown %d\n", unknown);
  client.cancel();
  return 0;
}

int main(int argc, char** argv) {
  std::setvbuf(stdout, nullptr, _IOLBF, 0);
  std::vector<std::string> args(argv + 1, argv + argc);
  auto number = [&](size_t at) { return at < args.size() ? std::stod(args[at]) : 0.0; };
  if (args.size() == 2 && args[1] == "fleet") return read_fleet(std::stoi(args[0]));
  if (args.size() == 3 && args[1] == "hostile") return hostile(std::stoi(args[0]), args[2]);
  if (args.size() == 4 && args[1] == "takeoff") return take_off(std::stoi(args[0]), args[2], number(3));
  if (args.size() == 6 && args[1] == "goto") return go(std::stoi(args[0]), args[2], {number(3), number(4), number(5)}, 0);
  if (args.size() == 7 && args[1] == "cancel")
    return go(std::stoi(args[0]), args[2], {number(3), number(4), number(5)}, number(6));
  std::fprintf(stderr, "usage: action_node DOMAIN fleet | goto|cancel|takeoff|hostile NAMESPACE ...\n");
  return 2;
}
