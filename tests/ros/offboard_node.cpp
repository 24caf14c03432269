// A node as MAVROS' users write them, on Fast DDS alone: it streams a setpoint, sets OFFBOARD, arms, flies a square and
// lands. Or it prints what it reads.
//
//   offboard_node DOMAIN echo SECONDS NAMESPACE...
//   offboard_node DOMAIN fly NAMESPACE LAND_MODE
//   offboard_node DOMAIN px4 NAMESPACE          the same by PX4's own topics, as PX4's offboard_control example
#include "dds_node.hpp"

using State = mavros_msgs::msg::dds_::State_;
using Imu = sensor_msgs::msg::dds_::Imu_;
using Fix = sensor_msgs::msg::dds_::NavSatFix_;
using Battery = sensor_msgs::msg::dds_::BatteryState_;
using Pose = geometry_msgs::msg::dds_::PoseStamped_;
using Arming = mavros_msgs::srv::dds_::CommandBool_Request_;
using Armed = mavros_msgs::srv::dds_::CommandBool_Response_;
using SetMode = mavros_msgs::srv::dds_::SetMode_Request_;
using ModeSent = mavros_msgs::srv::dds_::SetMode_Response_;

static int echo(int domain, double seconds, const std::vector<std::string>& namespaces) {
  Node node(domain);
  std::mutex mutex;
  for (const auto& ns : namespaces) {
    const char* n = ns.c_str();
    auto print = [&mutex](const std::string& line) {
      std::lock_guard<std::mutex> lock(mutex);
      std::puts(line.c_str());
    };
    char format[] = "%s %s %.9f %s %.9g %.9g %.9g %.9g";
    auto line = [print, n, format](const char* name, const std_msgs::msg::dds_::Header_& head, double a, double b,
                                   double c, double d) {
      char text[400];
      double stamp = head.stamp().sec() + head.stamp().nanosec() * 1e-9;
      std::snprintf(text, sizeof text, format, n, name, stamp, head.frame_id().c_str(), a, b, c, d);
      print(text);
    };
    node.read<State, mavros_msgs::msg::dds_::State_PubSubType>("rt" + ns + "/state", true, true, [line](const State& m) {
      line(m.mode().empty() ? "state:-" : ("state:" + m.mode()).c_str(), m.header(), m.connected(), m.armed(), m.guided(),
           m.system_status());
    });
    node.read<Imu, sensor_msgs::msg::dds_::Imu_PubSubType>("rt" + ns + "/imu/data", false, false, [line](const Imu& m) {
      line("imu/data", m.header(), m.orientation().w(), m.orientation().x(), m.orientation().y(), m.orientation().z());
    });
    node.read<Pose, geometry_msgs::msg::dds_::PoseStamped_PubSubType>(
        "rt" + ns + "/local_position/pose", false, false, [line](const Pose& m) {
          const auto& p = m.pose().position();
          line("local_position/pose", m.header(), p.x(), p.y(), p.z(), m.pose().orientation().w());
        });
    node.read<Fix, sensor_msgs::msg::dds_::NavSatFix_PubSubType>(
        "rt" + ns + "/global_position/global", false, false, [line](const Fix& m) {
          line("global_position/global", m.header(), m.latitude(), m.longitude(), m.altitude(),
               m.position_covariance()[8]);
        });
    node.read<Battery, sensor_msgs::msg::dds_::BatteryState_PubSubType>(
        "rt" + ns + "/battery", false, false, [line](const Battery& m) {
          line("battery", m.header(), m.voltage(), m.current(), m.percentage(), m.cell_voltage().size());
        });
  }
  pause_s(seconds);
  return 0;
}

static int fly(int domain, const std::string& ns, const std::string& land_mode) {
  Node node(domain);
  std::mutex mutex;
  State state;
  Pose pose;
  node.read<State, mavros_msgs::msg::dds_::State_PubSubType>("rt" + ns + "/state", true, true, [&](const State& m) {
    std::lock_guard<std::mutex> lock(mutex);
    state = m;
  });
  node.read<Pose, geometry_msgs::msg::dds_::PoseStamped_PubSubType>("rt" + ns + "/local_position/pose", false, false,
                                                                    [&](const Pose& m) {
                                                                      std::lock_guard<std::mutex> lock(mutex);
                                                                      pose = m;
                                                                    });
  auto* setpoints = node.write<geometry_msgs::msg::dds_::PoseStamped_PubSubType>("rt" + ns + "/setpoint_position/local");
  Client<Arming, Armed, mavros_msgs::srv::dds_::CommandBool_Request_PubSubType,
         mavros_msgs::srv::dds_::CommandBool_Response_PubSubType>
      arming(node, ns + "/cmd/arming");
  Client<SetMode, ModeSent, mavros_msgs::srv::dds_::SetMode_Request_PubSubType,
         mavros_msgs::srv::dds_::SetMode_Response_PubSubType>
      set_mode(node, ns + "/set_mode");
  auto seen = [&] {
    std::lock_guard<std::mutex> lock(mutex);
    return state;
  };
  auto place = [&] {
    std::lock_guard<std::mutex> lock(mutex);
    return pose.pose().position();
  };
  double target[3] = {0, 0, 4};
  bool streaming = true;
  std::thread stream([&] {
    while (streaming) {
      Pose setpoint;
      setpoint.pose().position().x(target[0]);
      setpoint.pose().position().y(target[1]);
      setpoint.pose().position().z(target[2]);
      setpoint.pose().orientation().w(1);
      setpoints->write(&setpoint);
      pause_s(0.05);
    }
  });
  auto end = [&](int code, const char* why) {
    std::puts(why);
    streaming = false;
    stream.join();
    return code;
  };
  double until = now_s() + 120;
  while (!seen().connected() && now_s() < until) pause_s(0.1);
  pause_s(2);
  // as the examples of PX4 and MAVROS do it: again every two seconds until the state shows it
  for (; seen().mode() != "OFFBOARD" && now_s() < until; pause_s(2)) {
    SetMode request;
    request.custom_mode("OFFBOARD");
    ModeSent response;
    if (set_mode.call(request, response)) std::printf("mode_sent %d\n", response.mode_sent());
  }
  for (; !seen().armed() && now_s() < until; pause_s(2)) {
    Arming request;
    request.value(true);
    Armed response;
    if (arming.call(request, response)) std::printf("armed %d %d\n", response.success(), response.result());
  }
  const double square[][3] = {{0, 0, 4}, {0, 4, 4}, {2, 4, 4}, {2, 0, 4}, {0, 0, 4}};
  for (const auto& corner : square) {
    for (int i = 0; i < 3; i++) target[i] = corner[i];
    double error = 1e9, corner_until = now_s() + 120;
    while (error > 0.5 && now_s() < corner_until) {
      auto p = place();
      error = std::sqrt(std::pow(p.x() - corner[0], 2) + std::pow(p.y() - corner[1], 2) + std::pow(p.z() - corner[2], 2));
      pause_s(0.05);
    }
    std::printf("corner %g %g %g error %.2f mode %s\n", corner[0], corner[1], corner[2], error, seen().mode().c_str());
    std::fflush(stdout);
    if (error > 0.5) return end(1, "a corner was not reached");
  }
  SetMode land;
  land.custom_mode(land_mode);
  ModeSent response;
  if (!set_mode.call(land, response) || !response.mode_sent()) return end(1, "landing was refused");
  for (until = now_s() + 180; seen().armed() && now_s() < until;) pause_s(0.1);
  return seen().armed() ? end(1, "it did not land") : end(0, "landed");
}

// PX4's topics: best effort, and the last sample for a reader that comes later, as PX4's examples ask for.
template <class T, class Support>
static void read_px4(Node& node, const std::string& name, std::function<void(const T&)> on_message) {
  node.read<T, Support>("rt" + name, false, true, on_message);
}

static int fly_px4(int domain, const std::string& ns) {
  using namespace px4_msgs::msg::dds_;
  Node node(domain);
  std::mutex mutex;
  VehicleStatus_ status;
  VehicleLocalPosition_ local;
  VehicleAttitude_ attitude;
  VehicleGlobalPosition_ global;
  VehicleOdometry_ odometry;
  BatteryStatus_ battery;
  std::vector<VehicleCommandAck_> acks;
  auto keep = [&mutex](auto& kept) {
    return [&mutex, &kept](const auto& m) {
      std::lock_guard<std::mutex> lock(mutex);
      kept = m;
    };
  };
  std::string out = ns + "/fmu/out/", in = "rt" + ns + "/fmu/in/";
  read_px4<VehicleStatus_, VehicleStatus_PubSubType>(node, out + "vehicle_status_v1", keep(status));
  read_px4<VehicleLocalPosition_, VehicleLocalPosition_PubSubType>(node, out + "vehicle_local_position", keep(local));
  read_px4<VehicleAttitude_, VehicleAttitude_PubSubType>(node, out + "vehicle_attitude", keep(attitude));
  read_px4<VehicleGlobalPosition_, VehicleGlobalPosition_PubSubType>(node, out + "vehicle_global_position", keep(global));
  read_px4<VehicleOdometry_, VehicleOdometry_PubSubType>(node, out + "vehicle_odometry", keep(odometry));
  read_px4<BatteryStatus_, BatteryStatus_PubSubType>(node, out + "battery_status", keep(battery));
  read_px4<VehicleCommandAck_, VehicleCommandAck_PubSubType>(node, out + "vehicle_command_ack",
                                                             [&](const VehicleCommandAck_& m) {
                                                               std::lock_guard<std::mutex> lock(mutex);
                                                               acks.push_back(m);
                                                             });
  auto* modes = node.write<OffboardControlMode_PubSubType>(in + "offboard_control_mode");
  auto* setpoints = node.write<TrajectorySetpoint_PubSubType>(in + "trajectory_setpoint");
  auto* commands = node.write<VehicleCommand_PubSubType>(in + "vehicle_command");
  auto command = [&](uint32_t number, float param1, float param2, float param3, uint8_t target) {
    VehicleCommand_ m;
    m.command(number);
    m.param1(param1);
    m.param2(param2);
    m.param3(param3);
    m.target_system(target);
    m.target_component(1);
    m.source_system(1);
    m.source_component(1);
    m.from_external(true);
    commands->write(&m);
  };
  auto seen = [&] {
    std::lock_guard<std::mutex> lock(mutex);
    return status;
  };
  double target[3] = {0, 0, -4};  // north, east, down
  bool streaming = true;
  std::thread stream([&] {
    while (streaming) {
      OffboardControlMode_ mode;
      mode.position(true);
      modes->write(&mode);
      TrajectorySetpoint_ setpoint;
      for (int i = 0; i < 3; i++) {
        setpoint.position()[i] = target[i];
        setpoint.velocity()[i] = setpoint.acceleration()[i] = setpoint.jerk()[i] = NAN;
      }
      setpoint.yaw(0);
      setpoint.yawspeed(NAN);
      setpoints->write(&setpoint);
      pause_s(0.05);
    }
  });
  auto end = [&](int code, const char* why) {
    std::puts(why);
    streaming = false;
    stream.join();
    return code;
  };
  double until = now_s() + 120;
  while (!seen().system_id() && now_s() < until) pause_s(0.1);
  uint8_t self = seen().system_id();
  pause_s(2);
  command(400, 1, 0, 0, self + 1);  // another vehicle's: nothing may come of it
  pause_s(2);
  if (seen().arming_state() != 1) return end(1, "another vehicle's command armed it");
  // OFFBOARD is refused until its local frame's origin is known; an armed vehicle that waits on the ground disarms itself
  for (; (seen().arming_state() != 2 || seen().nav_state() != 14) && now_s() < until; pause_s(3)) {
    command(176, 1, 6, 0, self);
    command(400, 1, 0, 0, self);
  }
  const double square[][3] = {{0, 0, -4}, {4, 0, -4}, {4, 2, -4}, {0, 0, -4}};
  for (const auto& corner : square) {
    for (int i = 0; i < 3; i++) target[i] = corner[i];
    double error = 1e9, corner_until = now_s() + 120;
    while (error > 0.5 && now_s() < corner_until) {
      {
        std::lock_guard<std::mutex> lock(mutex);
        error = std::sqrt(std::pow(local.x() - corner[0], 2) + std::pow(local.y() - corner[1], 2) +
                          std::pow(local.z() - corner[2], 2));
      }
      pause_s(0.05);
    }
    std::printf("corner %g %g %g error %.2f nav_state %d\n", corner[0], corner[1], corner[2], error, seen().nav_state());
    if (error > 0.5) return end(1, "a corner was not reached");
  }
  {
    std::lock_guard<std::mutex> lock(mutex);
    std::printf("global %.7f %.7f %.2f\n", global.lat(), global.lon(), global.alt());
    std::printf("battery %.3f %.3f\n", battery.voltage_v(), battery.remaining());
    std::printf("q %.6f %.6f %.6f %.6f\n", attitude.q()[0], attitude.q()[1], attitude.q()[2], attitude.q()[3]);
    std::printf("odometry %d %.3f %.3f %.3f\n", odometry.pose_frame(), odometry.position()[0], odometry.position()[1],
                odometry.position()[2]);
  }
  command(21, 0, 0, 0, 0);
  for (until = now_s() + 180; seen().arming_state() == 2 && now_s() < until;) pause_s(0.1);
  for (const auto& ack : acks) std::printf("ack %u %d\n", ack.command(), ack.result());
  return seen().arming_state() == 2 ? end(1, "it did not land") : end(0, "landed");
}

int main(int argc, char** argv) {
  std::setvbuf(stdout, nullptr, _IOLBF, 0);
  std::vector<std::string> args(argv + 1, argv + argc);
  if (args.size() >= 4 && args[1] == "echo")
    return echo(std::stoi(args[0]), std::stod(args[2]), {args.begin() + 3, args.end()});
  if (args.size() == 3 && args[1] == "px4") return fly_px4(std::stoi(args[0]), args[2]);
  if (args.size() == 4 && args[1] == "fly") return fly(std::stoi(args[0]), args[2], args[3]);
  std::fprintf(stderr, "usage: offboard_node DOMAIN echo SECONDS NAMESPACE... | DOMAIN fly NAMESPACE LAND_MODE\n");
  return 2;
}
