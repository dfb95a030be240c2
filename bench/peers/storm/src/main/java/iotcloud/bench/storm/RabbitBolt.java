package iotcloud.bench.storm;

import com.rabbitmq.client.AMQP.BasicProperties;
import com.rabbitmq.client.Channel;
import com.rabbitmq.client.ConnectionFactory;
import java.io.IOException;
import java.io.UncheckedIOException;
import java.util.Map;
import org.apache.storm.task.OutputCollector;
import org.apache.storm.task.TopologyContext;
import org.apache.storm.topology.OutputFieldsDeclarer;
import org.apache.storm.topology.base.BaseRichBolt;
import org.apache.storm.tuple.Tuple;

/** Sends a tuple to its driver's queue and acks it at once, without waiting for the broker to confirm. */
final class RabbitBolt extends BaseRichBolt {
    private static final int NOT_PERSISTENT = 1;

    private transient Channel channel;
    private transient OutputCollector collector;
    private String exchange;

    @Override
    public void prepare(Map<String, Object> conf, TopologyContext context, OutputCollector collector) {
        this.collector = collector;
        exchange = (String) conf.get(Echo.NAME);
        try {
            ConnectionFactory factory = new ConnectionFactory();
            factory.setUri((String) conf.get(Echo.URL));
            channel = factory.newConnection("bolt " + context.getThisTaskIndex()).createChannel();
            channel.exchangeDeclare(exchange, "direct", false);
        } catch (Exception error) {
            throw new IllegalStateException("cannot send to " + exchange, error);
        }
        Echo.taskConnected();
    }

    @Override
    @SuppressWarnings("unchecked")
    public void execute(Tuple tuple) {
        BasicProperties properties = new BasicProperties.Builder()
                .headers((Map<String, Object>) tuple.getValue(2)).deliveryMode(NOT_PERSISTENT).build();
        try {
            channel.basicPublish(exchange, exchange + "." + tuple.getString(0) + ".control", properties, tuple.getBinary(1));
        } catch (IOException error) {
            throw new UncheckedIOException(error);
        }
        collector.ack(tuple);
    }

    @Override
    public void declareOutputFields(OutputFieldsDeclarer declarer) {}
}
