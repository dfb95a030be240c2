package mix;

import org.apache.storm.topology.BasicOutputCollector;
import org.apache.storm.topology.OutputFieldsDeclarer;
import org.apache.storm.topology.base.BaseBasicBolt;
import org.apache.storm.tuple.Fields;
import org.apache.storm.tuple.Tuple;
import org.apache.storm.tuple.Values;

/** Emits each reading again, and by whom. */
public class Relay extends BaseBasicBolt {
  private static final long serialVersionUID = 1;

  @Override
  public void execute(Tuple tuple, BasicOutputCollector collector) {
    collector.emit(new Values(tuple.getStringByField("name"), tuple.getLongByField("number"),
        tuple.getDoubleByField("level"), "Java"));
  }

  @Override
  public void declareOutputFields(OutputFieldsDeclarer declarer) {
    declarer.declare(new Fields("name", "number", "level", "by"));
  }
}
