// A node on Fast DDS that knows no interface: it builds its types at run time (Fast DDS' dynamic types) from a table
// that the test writes out of skygcs' own, and reads every topic and calls every service in it.
//
//   every_topic_node DOMAIN TABLE
//
// The table, a line each; a struct comes before those that have it:
//
//   struct TYPE                           member NAME BASE plain|array|sequence COUNT
//   topic NAME TYPE RELIABLE LATCHED
//   service NAME REQUEST RESPONSE         their first two members are rmw_cyclonedds' header
//   input NAME TYPE                       a topic that is written
//
// Standard input: "call NUMBER SERVICE PATH=VALUE..." (PATH: waypoints.0.frame; VALUE of an array: 1,2,3),
// "write TOPIC PATH=VALUE...", "dump START" (of names), "end".
// Standard output: "reply NUMBER HEX JSON"; of a dump "topic NAME COUNT", then "message NAME HEX JSON" for the last ones:
// the bytes as they came, and what Fast DDS reads in them; "done".
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <deque>
#include <fstream>
#include <iostream>
#include <map>
#include <memory>
#include <mutex>
#include <sstream>
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
#include <fastrtps/types/DynamicData.h>
#include <fastrtps/types/DynamicDataFactory.h>
#include <fastrtps/types/DynamicPubSubType.h>
#include <fastrtps/types/DynamicTypeBuilder.h>
#include <fastrtps/types/DynamicTypeBuilderFactory.h>
#include <fastrtps/types/DynamicTypeBuilderPtr.h>

using namespace eprosima::fastdds::dds;
namespace types = eprosima::fastrtps::types;
using types::DynamicData;

static const size_t KEPT = 3;  // messages of each topic
static const uint64_t CLIENT = 0x5afe000000000002;

struct Member {
  std::string name, base, shape;
  uint32_t count;
};

struct Struct {
  std::vector<Member> members;
  types::DynamicType_ptr type;
};

static std::map<std::string, Struct> structs;

static types::DynamicType_ptr base_type(const std::string& base) {
  auto* make = types::DynamicTypeBuilderFactory::get_instance();
  if (structs.count(base)) return structs[base].type;
  if (base == "bool") return make->create_bool_type();
  if (base == "int8") return make->create_char8_type();  // Fast DDS 2.9 has no dynamic int8
  if (base == "uint8" || base == "byte" || base == "char") return make->create_byte_type();
  if (base == "int16") return make->create_int16_type();
  if (base == "uint16") return make->create_uint16_type();
  if (base == "int32") return make->create_int32_type();
  if (base == "uint32") return make->create_uint32_type();
  if (base == "int64") return make->create_int64_type();
  if (base == "uint64") return make->create_uint64_type();
  if (base == "float32") return make->create_float32_type();
  if (base == "float64") return make->create_float64_type();
  if (base == "string") return make->create_string_type();
  std::fprintf(stderr, "no base %s\n", base.c_str());
  std::exit(3);
}

static void build(const std::string& name) {
  auto* make = types::DynamicTypeBuilderFactory::get_instance();
  types::DynamicTypeBuilder_ptr builder = make->create_struct_builder();
  builder->set_name(name);
  Struct& made = structs[name];
  for (uint32_t i = 0; i < made.members.size(); i++) {
    const Member& m = made.members[i];
    types::DynamicType_ptr type = base_type(m.base);
    if (m.shape == "array") {
      types::DynamicTypeBuilder_ptr array = make->create_array_builder(type, {m.count});
      type = array->build();
    } else if (m.shape == "sequence") {
      types::DynamicTypeBuilder_ptr sequence = make->create_sequence_builder(type, types::BOUND_UNLIMITED);
      type = sequence->build();
    }
    builder->add_member(i, m.name, type);
  }
  made.type = builder->build();
}

static void quote(std::ostream& out, const std::string& text) {
  out << '"';
  for (unsigned char c : text) {
    char escaped[8];
    if (c == '"' || c == '\\') out << '\\' << c;
    else if (c < 0x20) std::snprintf(escaped, sizeof escaped, "\\u%04x", c), out << escaped;
    else out << c;
  }
  out << '"';
}

static void real(std::ostream& out, double value) {
  char text[40];
  if (std::isnan(value)) std::snprintf(text, sizeof text, "NaN");
  else if (std::isinf(value)) std::snprintf(text, sizeof text, value > 0 ? "Infinity" : "-Infinity");
  else std::snprintf(text, sizeof text, "%.17g", value);
  out << text;
}

static void show_struct(std::ostream& out, DynamicData* data, const Struct& of);

static void show_value(std::ostream& out, DynamicData* in, types::MemberId id, const std::string& base) {
  if (structs.count(base)) {
    DynamicData* inner = in->loan_value(id);
    show_struct(out, inner, structs[base]);
    in->return_loaned_value(inner);
  } else if (base == "bool") out << (in->get_bool_value(id) ? "true" : "false");
  else if (base == "int8") out << int(static_cast<signed char>(in->get_char8_value(id)));
  else if (base == "uint8" || base == "byte" || base == "char") out << int(in->get_byte_value(id));
  else if (base == "int16") out << in->get_int16_value(id);
  else if (base == "uint16") out << in->get_uint16_value(id);
  else if (base == "int32") out << in->get_int32_value(id);
  else if (base == "uint32") out << in->get_uint32_value(id);
  else if (base == "int64") out << in->get_int64_value(id);
  else if (base == "uint64") out << in->get_uint64_value(id);
  else if (base == "float32") real(out, in->get_float32_value(id));
  else if (base == "float64") real(out, in->get_float64_value(id));
  else quote(out, in->get_string_value(id));
}

static void show_struct(std::ostream& out, DynamicData* data, const Struct& of) {
  out << '{';
  for (uint32_t i = 0; i < of.members.size(); i++) {
    const Member& m = of.members[i];
    if (i) out << ',';
    quote(out, m.name);
    out << ':';
    if (m.shape == "plain") {
      show_value(out, data, i, m.base);
      continue;
    }
    DynamicData* list = data->loan_value(i);
    uint32_t count = m.shape == "array" ? m.count : list->get_item_count();
    out << '[';
    for (uint32_t n = 0; n < count; n++) {
      if (n) out << ',';
      show_value(out, list, n, m.base);
    }
    out << ']';
    data->return_loaned_value(list);
  }
  out << '}';
}

static void set_value(DynamicData* in, types::MemberId id, const std::string& base, const std::string& text) {
  if (base == "bool") in->set_bool_value(text == "true", id);
  else if (base == "int8") in->set_char8_value(char(std::stoi(text)), id);
  else if (base == "uint8" || base == "byte" || base == "char") in->set_byte_value(types::octet(std::stoi(text)), id);
  else if (base == "int16") in->set_int16_value(int16_t(std::stoi(text)), id);
  else if (base == "uint16") in->set_uint16_value(uint16_t(std::stoi(text)), id);
  else if (base == "int32") in->set_int32_value(std::stoi(text), id);
  else if (base == "uint32") in->set_uint32_value(uint32_t(std::stoul(text)), id);
  else if (base == "int64") in->set_int64_value(std::stoll(text), id);
  else if (base == "uint64") in->set_uint64_value(std::stoull(text), id);
  else if (base == "float32") in->set_float32_value(std::stof(text), id);
  else if (base == "float64") in->set_float64_value(std::stod(text), id);
  else in->set_string_value(text, id);
}

static void set_path(DynamicData* data, const Struct& of, const std::string& path, const std::string& text) {
  std::string name = path.substr(0, path.find('.'));
  std::string rest = path.find('.') == std::string::npos ? "" : path.substr(path.find('.') + 1);
  uint32_t i = 0;
  while (i < of.members.size() && of.members[i].name != name) i++;
  if (i == of.members.size()) throw std::runtime_error("no member " + name);
  const Member& m = of.members[i];
  bool is_struct = structs.count(m.base);
  if (m.shape == "plain" && !is_struct) return set_value(data, i, m.base, text);
  DynamicData* inner = data->loan_value(i);
  if (m.shape == "plain") set_path(inner, structs[m.base], rest, text);
  else if (is_struct) {
    uint32_t n = uint32_t(std::stoul(rest));
    types::MemberId id = n;
    while (inner->get_item_count() <= n)
      inner->insert_complex_value(types::DynamicDataFactory::get_instance()->create_data(structs[m.base].type), id);
    DynamicData* element = inner->loan_value(n);
    set_path(element, structs[m.base], rest.substr(rest.find('.') + 1), text);
    inner->return_loaned_value(element);
  } else {
    std::stringstream values(text);
    std::string value;
    for (types::MemberId n = 0; std::getline(values, value, ','); n++) set_value(inner, n, m.base, value);
  }
  data->return_loaned_value(inner);
}

// Readers get the bytes alone, as a std::string: to decode every sample of 160 topics takes more than one core. What is
// shown is decoded by the same type.
class Support : public types::DynamicPubSubType {
public:
  explicit Support(types::DynamicType_ptr type) : types::DynamicPubSubType(type) {
    m_typeSize = 1024;  // to begin with: that of Fast DDS is of a hundred elements in each sequence of each sequence
    auto_fill_type_information(false);
    auto_fill_type_object(false);
  }
  bool deserialize(eprosima::fastrtps::rtps::SerializedPayload_t* payload, void* bytes) override {
    static_cast<std::string*>(bytes)->assign(reinterpret_cast<char*>(payload->data), payload->length);
    return true;
  }
  void decode(const std::string& bytes, DynamicData* data) {
    eprosima::fastrtps::rtps::SerializedPayload_t payload(uint32_t(bytes.size()));
    std::copy(bytes.begin(), bytes.end(), payload.data);
    payload.length = uint32_t(bytes.size());
    types::DynamicPubSubType::deserialize(&payload, data);
  }
};

static std::mutex kept_mutex;     // of messages that are kept
static std::mutex dynamic_mutex;  // of Fast DDS' dynamic data, which several threads may not make at once

static std::string hex(const std::string& bytes) {
  static const char digits[] = "0123456789abcdef";
  std::string text;
  for (unsigned char c : bytes) {
    text += digits[c >> 4];
    text += digits[c & 15];
  }
  return text;
}

class Reader : public DataReaderListener {
public:
  std::string name;
  const Struct* of = nullptr;
  Support* support = nullptr;
  bool is_reply = false;
  long count = 0;
  std::deque<std::string> last;
  DataReader* reader = nullptr;

  void on_data_available(DataReader* from) override {
    std::string bytes;
    SampleInfo info;
    while (from->take_next_sample(&bytes, &info) == ReturnCode_t::RETCODE_OK) {
      if (!info.valid_data) continue;
      if (is_reply) {
        answer(bytes);
        continue;
      }
      std::lock_guard<std::mutex> lock(kept_mutex);
      count++;
      last.push_back(bytes);
      if (last.size() > KEPT) last.pop_front();
    }
  }

  std::string shown(const std::string& bytes) {
    return with(bytes, [](DynamicData*) { return true; });
  }

private:
  void answer(const std::string& bytes) {
    long long number = 0;
    std::string text = with(bytes, [&number](DynamicData* data) {
      number = data->get_int64_value(1);
      return data->get_uint64_value(0) == CLIENT;
    });
    if (!text.empty()) std::printf("reply %lld %s\n", number, text.c_str());
  }

  template <class Wanted>
  std::string with(const std::string& bytes, Wanted wanted) {
    std::lock_guard<std::mutex> lock(dynamic_mutex);
    DynamicData* data = types::DynamicDataFactory::get_instance()->create_data(of->type);
    support->decode(bytes, data);
    std::ostringstream json;
    if (wanted(data)) {
      json << hex(bytes) << ' ';
      show_struct(json, data, *of);
    }
    types::DynamicDataFactory::get_instance()->delete_data(data);
    return json.str();
  }
};

class Node {
public:
  explicit Node(int domain) {
    participant = DomainParticipantFactory::get_instance()->create_participant(domain, PARTICIPANT_QOS_DEFAULT);
    publisher = participant->create_publisher(PUBLISHER_QOS_DEFAULT);
    subscriber = participant->create_subscriber(SUBSCRIBER_QOS_DEFAULT);
  }

  void read(const std::string& dds_name, const std::string& name, const std::string& type, bool reliable, bool latched,
            bool is_reply) {
    auto made = std::make_unique<Reader>();
    made->name = name;
    made->of = &structs.at(type);
    made->is_reply = is_reply;
    auto* described = topic(dds_name, type);
    made->support = static_cast<Support*>(supports.at(type).get());
    DataReaderQos qos = DATAREADER_QOS_DEFAULT;
    qos.reliability().kind = reliable ? RELIABLE_RELIABILITY_QOS : BEST_EFFORT_RELIABILITY_QOS;
    qos.durability().kind = latched ? TRANSIENT_LOCAL_DURABILITY_QOS : VOLATILE_DURABILITY_QOS;
    // Fast DDS 2.9 uses a sample of several fragments after it has freed it when the last ones only are kept
    qos.history().kind = KEEP_ALL_HISTORY_QOS;
    qos.endpoint().history_memory_policy = eprosima::fastrtps::rtps::PREALLOCATED_WITH_REALLOC_MEMORY_MODE;
    made->reader = subscriber->create_datareader(described, qos, made.get());
    (is_reply ? replies : readers)[name] = std::move(made);
  }

  void input(const std::string& dds_name, const std::string& name, const std::string& type) {
    DataWriterQos qos = DATAWRITER_QOS_DEFAULT;
    qos.reliability().kind = RELIABLE_RELIABILITY_QOS;
    qos.durability().kind = VOLATILE_DURABILITY_QOS;
    qos.history().depth = 10;
    qos.endpoint().history_memory_policy = eprosima::fastrtps::rtps::PREALLOCATED_WITH_REALLOC_MEMORY_MODE;
    writers[name] = {publisher->create_datawriter(topic(dds_name, type), qos), type};
  }

  void client(const std::string& name, const std::string& request, const std::string& response) {
    input("rq" + name + "Request", name, request);
    read("rr" + name + "Reply", name, response, true, false, true);
  }

  void write(const std::string& name, long long number, std::istream& fields) {
    auto [writer, type] = writers.at(name);
    for (int i = 0; i < 3000 && !matched(name, writer); i++) std::this_thread::sleep_for(std::chrono::milliseconds(10));
    std::lock_guard<std::mutex> lock(dynamic_mutex);
    DynamicData* data = types::DynamicDataFactory::get_instance()->create_data(structs[type].type);
    if (replies.count(name)) {
      data->set_uint64_value(CLIENT, 0);
      data->set_int64_value(number, 1);
    }
    for (std::string word; fields >> word;)
      set_path(data, structs[type], word.substr(0, word.find('=')), word.substr(word.find('=') + 1));
    writer->write(data);
    types::DynamicDataFactory::get_instance()->delete_data(data);
  }

  void dump(const std::string& start) {
    for (auto& [name, reader] : readers) {
      if (name.rfind(start, 0) != 0) continue;
      std::unique_lock<std::mutex> lock(kept_mutex);
      auto last = reader->last;
      std::printf("topic %s %ld\n", name.c_str(), reader->count);
      lock.unlock();
      for (auto& bytes : last) std::printf("message %s %s\n", name.c_str(), reader->shown(bytes).c_str());
    }
    std::puts("done");
  }

private:
  Topic* topic(const std::string& dds_name, const std::string& type) {
    if (!supports.count(type)) {
      supports[type] = TypeSupport(new Support(structs.at(type).type));
      supports[type].register_type(participant, type);
    }
    return participant->create_topic(dds_name, type, TOPIC_QOS_DEFAULT);
  }

  bool matched(const std::string& name, DataWriter* writer) {
    PublicationMatchedStatus to;
    SubscriptionMatchedStatus from;
    writer->get_publication_matched_status(to);
    if (!replies.count(name)) return to.current_count;
    replies.at(name)->reader->get_subscription_matched_status(from);
    return to.current_count && from.current_count;
  }

  DomainParticipant* participant;
  Publisher* publisher;
  Subscriber* subscriber;
  std::map<std::string, TypeSupport> supports;
  std::map<std::string, std::unique_ptr<Reader>> readers, replies;
  std::map<std::string, std::pair<DataWriter*, std::string>> writers;
};

int main(int argc, char** argv) {
  if (argc != 3) return std::fprintf(stderr, "usage: every_topic_node DOMAIN TABLE\n"), 2;
  std::setvbuf(stdout, nullptr, _IOLBF, 0);
  Node node(std::stoi(argv[1]));
  std::ifstream table(argv[2]);
  std::string last;
  for (std::string line; std::getline(table, line);) {
    std::istringstream words(line);
    std::string what, name, type, other;
    words >> what >> name;
    if (what != "member" && !last.empty()) build(last), last.clear();
    if (what == "struct") last = name;
    else if (what == "member") {
      Member m{name, "", "", 0};
      words >> m.base >> m.shape >> m.count;
      structs[last].members.push_back(m);
    } else if (what == "topic") {
      int reliable, latched;
      words >> type >> reliable >> latched;
      node.read("rt" + name, name, type, reliable, latched, false);
    } else if (what == "service") {
      words >> type >> other;
      node.client(name, type, other);
    } else if (what == "input") {
      words >> type;
      node.input("rt" + name, name, type);
    }
  }
  std::puts("ready");
  for (std::string line; std::getline(std::cin, line);) {
    std::istringstream words(line);
    std::string what, name;
    long long number;
    words >> what;
    try {
      if (what == "dump") node.dump(words >> name ? name : "/");
      else if (what == "call" && words >> number >> name) node.write(name, number, words);
      else if (what == "write" && words >> name) node.write(name, 0, words);
      else if (what == "end") break;
    } catch (const std::exception& error) {
      std::printf("error %s: %s\n", line.c_str(), error.what());
    }
  }
  std::fflush(stdout);
  std::_Exit(0);  // the participants of a test need no farewell
}
