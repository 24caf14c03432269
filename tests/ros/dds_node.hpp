// What the programs of these tests share: a participant, topics and services of ROS 2 by Fast DDS alone. The names are
// those that rmw_fastrtps gives topics; services are rmw_cyclonedds'.
#pragma once
#include <chrono>
#include <cmath>
#include <cstdio>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/subscriber/DataReader.hpp>
#include <fastdds/dds/subscriber/DataReaderListener.hpp>
#include <fastdds/dds/subscriber/SampleInfo.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>
#include <fastdds/dds/topic/TypeSupport.hpp>

#include "typesPubSubTypes.h"

using namespace eprosima::fastdds::dds;

static double now_s() {
  return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

static void pause_s(double seconds) { std::this_thread::sleep_for(std::chrono::duration<double>(seconds)); }

template <class T>
class Listener : public DataReaderListener {
public:
  std::function<void(const T&)> on_message;
  void on_data_available(DataReader* reader) override {
    T message;
    SampleInfo info;
    while (reader->take_next_sample(&message, &info) == ReturnCode_t::RETCODE_OK)
      if (info.valid_data) on_message(message);
  }
};

class Node {
public:
  explicit Node(int domain) {
    participant = DomainParticipantFactory::get_instance()->create_participant(domain, PARTICIPANT_QOS_DEFAULT);
    publisher = participant->create_publisher(PUBLISHER_QOS_DEFAULT);
    subscriber = participant->create_subscriber(SUBSCRIBER_QOS_DEFAULT);
  }

  template <class Support>
  Topic* topic(const std::string& name) {
    if (topics.count(name)) return topics[name];
    TypeSupport support(new Support());
    support.register_type(participant);
    return topics[name] = participant->create_topic(name, support.get_type_name(), TOPIC_QOS_DEFAULT);
  }

  template <class T, class Support>
  void read(const std::string& name, bool reliable, bool latched, std::function<void(const T&)> on_message) {
    DataReaderQos qos = DATAREADER_QOS_DEFAULT;
    qos.reliability().kind = reliable ? RELIABLE_RELIABILITY_QOS : BEST_EFFORT_RELIABILITY_QOS;
    qos.durability().kind = latched ? TRANSIENT_LOCAL_DURABILITY_QOS : VOLATILE_DURABILITY_QOS;
    qos.history().depth = 10;
    auto listener = std::make_shared<Listener<T>>();
    listener->on_message = on_message;
    listeners.push_back(listener);
    subscriber->create_datareader(topic<Support>(name), qos, listener.get());
  }

  template <class Support>
  DataWriter* write(const std::string& name) {
    DataWriterQos qos = DATAWRITER_QOS_DEFAULT;
    qos.reliability().kind = RELIABLE_RELIABILITY_QOS;
    qos.durability().kind = VOLATILE_DURABILITY_QOS;
    qos.history().depth = 10;
    return publisher->create_datawriter(topic<Support>(name), qos, nullptr);
  }

private:
  DomainParticipant* participant;
  Publisher* publisher;
  Subscriber* subscriber;
  std::map<std::string, Topic*> topics;
  std::vector<std::shared_ptr<DataReaderListener>> listeners;
};

template <class Request, class Response, class RequestSupport, class ResponseSupport>
class Client {
public:
  Client(Node& node, const std::string& service) {
    requests = node.write<RequestSupport>("rq" + service + "Request");
    node.read<Response, ResponseSupport>("rr" + service + "Reply", true, false, [this](const Response& response) {
      if (response.client_guid() != id) return;
      std::lock_guard<std::mutex> lock(mutex);
      responses[response.sequence_number()] = response;
    });
  }

  bool call(Request request, Response& response, double timeout_s = 30) {
    write(request);
    return wait(response, timeout_s);
  }

  // The server's DDS has received the request when this returns.
  void ask(Request& request) {
    write(request);
    requests->wait_for_acknowledgments({30, 0});
  }

  bool wait(Response& response, double timeout_s) {
    for (double until = now_s() + timeout_s; now_s() < until; pause_s(0.02)) {
      std::lock_guard<std::mutex> lock(mutex);
      if (responses.count(sequence)) {
        response = responses[sequence];
        return true;
      }
    }
    return false;
  }

private:
  void write(Request& request) {
    request.client_guid(id);
    request.sequence_number(++sequence);
    requests->write(&request);
  }

  DataWriter* requests;
  std::mutex mutex;
  std::map<int64_t, Response> responses;
  uint64_t id = 0x5afe000000000001;
  int64_t sequence = 0;
};
